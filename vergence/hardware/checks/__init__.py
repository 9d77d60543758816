"""Checks before a robot moves: servos, their line, and cameras; each finding with its cure."""
