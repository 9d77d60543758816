"""Settling time and overshoot over the gain: Figure 15."""
