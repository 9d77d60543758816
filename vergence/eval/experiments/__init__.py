"""The article's experiments, one module each."""
