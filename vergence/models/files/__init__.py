"""Head files: presets, reading and writing TOML, the rules a file must meet, and imports."""
