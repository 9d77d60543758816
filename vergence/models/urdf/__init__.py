"""A head from a robot description: its mechanism, chains of joints, motors and cameras."""
