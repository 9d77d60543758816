"""Dynamixel X-series servos: packets of Protocol 2.0, registers, and a bus of servos."""
