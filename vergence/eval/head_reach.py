"""Reach of a head: the points that both eyes can fixate and see with the neck at rest."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.models.posture import fixation_angles_and_visibility, midpoint_between_cameras

NEAREST_M: Final = 0.01
"""Least depth of the search, m (chosen)."""
_FARTHEST_M: Final = 100.0
"""Greatest depth of the search, m; the reach counts as infinite from there (chosen)."""
_SEARCH_DIRECTIONS: Final = (
    ("left", 0, -1.0),
    ("right", 0, 1.0),
    ("up", 1, -1.0),
    ("down", 1, 1.0),
)
"""Name, axis of N and sign of the directions in which the widest angles are searched."""
_FORWARD: Final = np.array([0.0, 0.0, 1.0])
"""Direction straight ahead in N (numerical: a unit vector)."""
_ANGLE_SEARCH_DISTANCE_M: Final = 1.0
"""Distance at which the widest angles are searched, or twice the nearest depth if larger, m
(chosen)."""


@dataclass(frozen=True, kw_only=True)
class Reach:
    """Limits within which both eyes can fixate a point and see it, with the neck at rest."""

    nearest_m: float
    """Least depth straight ahead, from midway between the eyes; nan if there is none."""
    farthest_m: float
    """Greatest depth straight ahead; inf beyond 100 m."""
    distance_m: float
    """Distance from midway between the eyes to which the angles apply."""
    left_deg: float
    """Widest angle from straight ahead at that distance; nan if there is none."""
    right_deg: float
    up_deg: float
    down_deg: float


def find_reach(head: HeadModel) -> Reach:
    """Find the reach of a head with the neck at rest.

    Args:
        head: one head, not a population.
    """
    centre = midpoint_between_cameras(head)

    def can(directions: FloatArray) -> NDArray[np.bool_]:
        return fixation_angles_and_visibility(head, centre + directions)[1]

    depths = np.geomspace(NEAREST_M, _FARTHEST_M, 2001)
    reached = np.flatnonzero(can(depths[:, None] * _FORWARD))
    nearest = farthest = np.nan
    if reached.size:
        nearest, farthest = depths[reached[0]], depths[reached[-1]]
        farthest = np.inf if reached[-1] == len(depths) - 1 else farthest
    distance = float(np.nanmax([_ANGLE_SEARCH_DISTANCE_M, 2.0 * nearest]))
    angles = np.radians(np.linspace(0.0, 179.0, 1791))
    widest = {}
    for name, axis, sign in _SEARCH_DIRECTIONS:
        failed = np.flatnonzero(~can(distance * _directions(angles, axis, sign)))
        last = failed[0] - 1 if failed.size else len(angles) - 1
        widest[f"{name}_deg"] = float(np.degrees(angles[last])) if last >= 0 else float("nan")
    return Reach(
        nearest_m=float(nearest), farthest_m=float(farthest), distance_m=distance, **widest
    )


def off_axis_reach_points(head: HeadModel, reach: Reach) -> FloatArray:
    """Points at the sides and corners of a reach: at its widest angles and halfway there.

    Args:
        head: the head.
        reach: the head's reach.

    Returns:
        (n, 3) in N, m; none on a side without reach. Points in corners may be out of reach.
    """
    sides: list[list[FloatArray]] = [[], []]
    for name, axis, sign in _SEARCH_DIRECTIONS:
        widest = np.radians(getattr(reach, f"{name}_deg"))
        if np.isfinite(widest):
            sides[axis] += list(_directions(np.array([0.5, 1.0]) * widest, axis, sign))
    corners = [across + down - _FORWARD for across in sides[0] for down in sides[1]]
    found = np.array([*sides[0], *sides[1], *corners], np.float64).reshape(-1, 3)
    return np.asarray(midpoint_between_cameras(head) + reach.distance_m * found, np.float64)


def _directions(angles: FloatArray, axis: int, sign: float) -> FloatArray:
    """(n, 3) directions at angles from straight ahead towards one side."""
    directions: FloatArray = np.cos(angles)[:, None] * _FORWARD
    directions[:, axis] += sign * np.sin(angles)
    return directions
