"""The physical twin: a population of true heads that stands for the article's one head."""
