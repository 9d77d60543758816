"""Calibration of a head's joints and eyes from views of a board while the head moved."""
