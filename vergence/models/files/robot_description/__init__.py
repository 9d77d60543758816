"""Robot descriptions that others wrote, URDF and MJCF, and the head that is in one."""
