"""Our head against a fixed pair of cameras: Table 7, Figure 14."""
