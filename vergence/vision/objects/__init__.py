"""Objects and points to look at, other than printed targets."""
