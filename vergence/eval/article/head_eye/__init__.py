"""Calibration of the article's head: Section 5.1.2, Table 5, Figure 10."""
