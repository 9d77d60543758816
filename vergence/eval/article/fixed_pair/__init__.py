"""Comparison of our head with a fixed pair of cameras: Table 7, Figure 14."""
