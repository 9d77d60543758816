"""`vergence tune`: the options with which a controller does best."""
