"""Prediction of the present from delayed images: delay, actuator response, goals, target motion."""
