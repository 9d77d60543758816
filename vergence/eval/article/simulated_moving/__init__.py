"""A moving target on the simulated rig: Figure 8."""
