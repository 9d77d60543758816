"""Static targets on the physical twin: Table 5, Figures 10 and 11."""
