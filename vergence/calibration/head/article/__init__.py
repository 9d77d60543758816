"""The experiment of `vergence reproduce` that calibrates the article's head, above `eval`."""
