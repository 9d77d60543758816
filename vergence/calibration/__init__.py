"""Calibration of a robot's cameras from photographs of a board."""
