"""Settling time of a gaze shift on the physical rig: section 5.3.2."""
