"""A policy on a robot: gazes that are logged, and what a log tells afterwards."""
