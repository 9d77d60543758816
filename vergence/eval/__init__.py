"""Evaluation: runs, their metrics, and their reports and figures."""
