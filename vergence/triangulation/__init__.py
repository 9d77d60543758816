"""Triangulation of a 3-D point and its covariance from joint angles and pixels."""

from vergence.triangulation.fix import (
    Fix,
    Noise,
    gap_sigma,
    triangulate_fixations,
    triangulate_gaze,
    triangulate_views,
)

__all__ = [
    "Fix",
    "Noise",
    "gap_sigma",
    "triangulate_fixations",
    "triangulate_gaze",
    "triangulate_views",
]
