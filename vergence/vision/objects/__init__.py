"""Things without a printed pattern to look at: points, balls, faces, and a room around them."""
