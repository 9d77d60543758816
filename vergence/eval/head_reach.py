"""Where a head can look: the points that both eyes reach and see, the neck at rest."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vergence.models.head import HeadModel
from vergence.models.joints import NECK
from vergence.models.parts import FloatArray

NEAREST_M: Final = 0.01
"""From this depth on the reach is looked for."""
_FARTHEST_M: Final = 100.0
_SIDES: Final = (("left", 0, -1.0), ("right", 0, 1.0), ("up", 1, -1.0), ("down", 1, 1.0))
"""Axis of N and sign of the directions in which the widest angles are looked for."""
_FORWARD: Final = np.array([0.0, 0.0, 1.0])
_DIRECTION_M: Final = 1.0
"""At this distance the widest angles are looked for, or at twice the nearest depth if larger."""


@dataclass(frozen=True, kw_only=True)
class Reach:
    """Where both eyes can look at a point and see it, the neck at rest."""

    nearest_m: float
    """Straight ahead, from midway between the eyes; nan where there is no such depth."""
    farthest_m: float
    """Straight ahead; inf beyond 100 m."""
    distance_m: float
    """From midway between the eyes, for the angles."""
    left_deg: float
    """Widest angle from straight ahead at that distance; nan where there is none."""
    right_deg: float
    up_deg: float
    down_deg: float


def centre_of(head: HeadModel) -> FloatArray:
    """Midway between the cameras at rest, (3,) in N, m."""
    return np.asarray(head.camera_poses(head.rest())[:, :3, 3].mean(axis=0), np.float64)


def look_at(head: HeadModel, points: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Joint angles with which both eyes look at points of N, and whether they then see them.

    Eyes that do not move stay as they are; those that cannot fixate exactly come nearest.

    Args:
        head: one head, not a population.
        points: (n, 3) in N, m.

    Returns:
        (n, 7) joint angles, rad, the neck at rest; (n,) whether both eyes see the point then.
    """
    rest = head.rest()
    if head.actuation.count:
        q = head.fixate(points, rest[NECK])
        can = head.reaches(q, -1e-9)
    else:
        q = np.broadcast_to(rest, (len(points), len(rest)))
        can = np.ones(len(points), np.bool_)
    pixels = head.project(q, points)  # nan behind a camera
    inside = (pixels >= -0.5) & (pixels <= head.cameras.size - 0.5)
    return q, np.asarray(can & inside.all(axis=(-1, -2)), np.bool_)


def reach_of(head: HeadModel) -> Reach:
    """Where both eyes can look at a point and see it, the neck at rest.

    Args:
        head: one head, not a population.
    """
    centre = centre_of(head)

    def can(directions: FloatArray) -> NDArray[np.bool_]:
        return look_at(head, centre + directions)[1]

    depths = np.geomspace(NEAREST_M, _FARTHEST_M, 2001)
    reached = np.flatnonzero(can(depths[:, None] * _FORWARD))
    nearest = farthest = np.nan
    if reached.size:
        nearest, farthest = depths[reached[0]], depths[reached[-1]]
        farthest = np.inf if reached[-1] == len(depths) - 1 else farthest
    distance = float(np.nanmax([_DIRECTION_M, 2.0 * nearest]))
    angles = np.radians(np.linspace(0.0, 179.0, 1791))
    widest = {}
    for name, axis, sign in _SIDES:
        failed = np.flatnonzero(~can(distance * _directions(angles, axis, sign)))
        last = failed[0] - 1 if failed.size else len(angles) - 1
        widest[f"{name}_deg"] = float(np.degrees(angles[last])) if last >= 0 else float("nan")
    return Reach(
        nearest_m=float(nearest), farthest_m=float(farthest), distance_m=distance, **widest
    )


def points_of(head: HeadModel, reach: Reach) -> FloatArray:
    """Points at the sides and corners of a reach: at its widest angles and halfway there.

    Args:
        head: the head.
        reach: its own.

    Returns:
        (n, 3) in N, m; none on a side where it sees nothing. Those in corners may be beyond it.
    """
    sides: list[list[FloatArray]] = [[], []]
    for name, axis, sign in _SIDES:
        widest = np.radians(getattr(reach, f"{name}_deg"))
        if np.isfinite(widest):
            sides[axis] += list(_directions(np.array([0.5, 1.0]) * widest, axis, sign))
    corners = [across + down - _FORWARD for across in sides[0] for down in sides[1]]
    found = np.array([*sides[0], *sides[1], *corners], np.float64).reshape(-1, 3)
    return np.asarray(centre_of(head) + reach.distance_m * found, np.float64)


def _directions(angles: FloatArray, axis: int, sign: float) -> FloatArray:
    """(n, 3) directions at angles from straight ahead towards one side."""
    directions: FloatArray = np.cos(angles)[:, None] * _FORWARD
    directions[:, axis] += sign * np.sin(angles)
    return directions
