"""The present from old images and joints: delay, joints, goals, the motion of a target."""
