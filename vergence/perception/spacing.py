"""Distances between neighbouring corners in space, to be checked against the stated one."""

from collections.abc import Iterable
from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from vergence.models.parts import FloatArray
from vergence.vision.tag_families import AprilGrid
from vergence.vision.targets import AprilTag, PlanarTarget

MM: Final = 1000.0
"""Millimetres per metre (physical)."""


class EdgeSpacing(NamedTuple):
    """Distances between neighbouring corners: edges of squares, or of a tag."""

    mean_m: float
    """Mean distance; nan if there is none."""
    spread_m: float
    """Standard deviation of the distances."""
    edge_count: int
    """Number of distances."""
    stated_m: float
    """Stated distance; nan if no size was stated."""

    def document(self) -> dict[str, Any]:
        """Plain values, millimetres."""
        return {
            "mean": None if np.isnan(self.mean_m) else MM * self.mean_m,
            "spread": None if np.isnan(self.spread_m) else MM * self.spread_m,
            "count": self.edge_count,
            "stated": None if np.isnan(self.stated_m) else MM * self.stated_m,
        }


def stated_edge_m(target: PlanarTarget) -> float:
    """Stated edge of a board's squares, of a grid's tags, or of a tag."""
    if isinstance(target, AprilGrid):
        return target.tag_m
    return target.edge_m if isinstance(target, AprilTag) else target.square_m


@lru_cache(maxsize=64)
def neighbour_pairs(target: PlanarTarget) -> NDArray[np.intp]:
    """(k, 2) pairs of corners that are one edge apart on the board."""
    if isinstance(target, AprilGrid):  # gaps between tags are not edges
        first = np.arange(len(target.corners_m))
        return np.column_stack([first, first - first % 4 + (first + 1) % 4])
    pairs = cKDTree(target.corners_m).query_pairs(
        1.01 * stated_edge_m(target), output_type="ndarray"
    )
    return np.asarray(pairs[np.lexsort(pairs.T[::-1])])


def neighbour_distances_m(target: PlanarTarget, points: FloatArray) -> FloatArray:
    """(k,) distances between neighbouring corners, m, of (n, 3) points, nan where unsolved."""
    first, second = neighbour_pairs(target).T
    apart = np.linalg.norm(points[first] - points[second], axis=-1)
    return np.asarray(apart[np.isfinite(apart)])


def measure_spacing(target: PlanarTarget, points: Iterable[FloatArray]) -> EdgeSpacing:
    """Mean and standard deviation of the distances over views, (n, 3) points each, m."""
    apart = np.concatenate([np.empty(0), *(neighbour_distances_m(target, each) for each in points)])
    stated = stated_edge_m(target) if target.size_known else np.nan
    if not len(apart):
        return EdgeSpacing(np.nan, np.nan, 0, stated)
    return EdgeSpacing(float(apart.mean()), float(apart.std()), len(apart), stated)
