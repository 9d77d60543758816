"""`vergence reproduce`: the article's experiments, a folder each, and what the article states."""
