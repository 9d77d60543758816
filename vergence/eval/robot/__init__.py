"""Policies on a robot: logged gazes, comparisons of controllers, and replays of logs."""
