"""Runs, their metrics, and what is written and drawn of them."""
