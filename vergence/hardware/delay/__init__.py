"""Measurement of a robot's loop: one eye makes a known motion, seen by its encoder and camera."""
