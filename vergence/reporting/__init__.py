"""Run folders, the report, the common style of all figures, and jobs on many processors."""
