"""Trials of one controller: scenarios, running them, metrics, the time-optimal bound."""
