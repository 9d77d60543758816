"""Triangulation of a 3-D point and its covariance from joint angles and pixels."""

from vergence.triangulation.fix import Fix, Noise, triangulate_gaze, triangulate_views
from vergence.triangulation.gap import gap_sigma
from vergence.triangulation.several import triangulate_fixations

__all__ = [
    "Fix",
    "Noise",
    "gap_sigma",
    "triangulate_fixations",
    "triangulate_gaze",
    "triangulate_views",
]
