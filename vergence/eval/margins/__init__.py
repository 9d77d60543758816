"""Margins: how far a loop may be from what its model says."""
