"""Run folders, the report, and the common style of all figures."""
