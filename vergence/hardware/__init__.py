"""Real robot heads: servos on a serial line, and emulated ones for the same line."""
