"""Targets in photographs: found, matched between two eyes, triangulated, drawn."""
