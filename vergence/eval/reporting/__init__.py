"""Run folders, the report, and one look for all figures."""
