"""Emulated hardware that answers byte for byte as the real one does."""
