"""`vergence evaluate`: controllers compared on the same trials."""
