"""Uncertainty: propagated, by Monte Carlo, in the closed loop, and its lower bound: section 4."""
