"""The order of joints and eyes, defined once for every array of the package."""

from typing import Final

JOINTS: Final = (
    "neck_yaw",
    "neck_roll",
    "neck_pitch",
    "left_tilt",
    "left_pan",
    "right_tilt",
    "right_pan",
)
"""Joint order of every array of joint angles, velocities and limits."""

NECK: Final = slice(0, 3)
"""The neck's joints in an array of all joints (numerical)."""

EYES: Final = slice(3, 7)
"""The eyes' joints in an array of all joints: left tilt and pan, then right (numerical)."""

EYE_NAMES: Final = ("left", "right")
"""Eye order of every array of cameras, pixels and image Jacobians."""

LINKS: Final = (
    (1, 0, "neck_yaw"),
    (2, 1, "neck_roll"),
    (3, 2, "neck_pitch"),
    (4, 3, "left_tilt"),
    (5, 4, "left_pan"),
    (6, 5, ""),
    (7, 3, "right_tilt"),
    (8, 7, "right_pan"),
    (9, 8, ""),
)
"""The tree of frames, (frame, parent, joint); an empty joint is a fixed link (Table 1)."""
