"""Calibration of a head's joints and eyes from what it saw of a board while it moved."""
