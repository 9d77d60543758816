"""Uncertainties: propagated, by Monte Carlo, of the closed loop, and the least: section 4."""
