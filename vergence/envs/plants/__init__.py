"""Simulated heads: how they move, what their sensors report, what each trial draws anew."""
