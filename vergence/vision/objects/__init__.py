"""Objects to look at other than printed targets, and a room that shows them."""
