"""Simulated heads: motion, sensors, and the conditions that each trial draws anew."""
