"""A moving target on the physical twin: Figures 12 and 13."""
