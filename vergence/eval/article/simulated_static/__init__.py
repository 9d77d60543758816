"""Static targets on the simulated rig: Table 3, Figures 6 and 7."""
