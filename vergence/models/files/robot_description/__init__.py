"""Robot descriptions in URDF or MJCF, and the extraction of a head from one."""
