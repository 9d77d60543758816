"""How long a gaze shift takes on the physical rig: section 5.3.2."""
