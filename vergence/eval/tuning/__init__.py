"""`vergence tune`: search for the best options of a controller."""
