"""Targets to look at: the position of each trial's target as a function of time."""
