"""A robot's loop, measured: one eye turns by a known way, and its encoder and its camera follow."""
