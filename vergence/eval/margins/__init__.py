"""Margins: the largest deviations of a control loop from its model that controllers tolerate."""
