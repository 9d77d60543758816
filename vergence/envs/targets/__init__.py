"""What there is to look at: where each trial's target is, as a function of time."""
