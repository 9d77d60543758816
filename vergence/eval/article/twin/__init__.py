"""The physical twin: a population of simulated true heads in place of the article's single head."""
