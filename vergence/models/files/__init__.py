"""Heads as files: presets, TOML there and back, the rules that a file must keep."""
