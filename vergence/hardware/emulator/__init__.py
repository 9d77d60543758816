"""Emulated hardware that answers byte for byte as the real one does, without any I/O."""
