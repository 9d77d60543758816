r"""Paths with corners: from knot to knot at constant angular speed, seen from one point, in N.

A path is a flat array of groups of four. The first group is (speed, x, y, z): the angular speed,
rad/s, and the viewpoint E, m. Each knot adds a group (t, x, y, z), s and m, the first at time zero.
From knot A to knot B, a time T later, the line of sight from E turns along a great circle and the
inverse of the distance changes, both at a constant rate. With u the unit vectors from E to the
knots, r their distances, and s the time since A,

    u(s) = (sin(speed (T - s)) u_A + sin(speed s) u_B) / sin(speed T)
    1 / r(s) = (1 - s / T) / r_A + (s / T) / r_B

so the angle between u_A and u_B must be speed T, less than pi. After the last knot the target goes
back along the path, and from the first knot forth again.
"""

from math import sin, sqrt
from typing import Final

from vergence.kernels import inlined, subroutine
from vergence.models.kinematics import Vector
from vergence.models.parts import FloatArray

MIN_PATH_LENGTH: Final = 12
"""Length of a path of two knots (numerical)."""


@inlined
def point_between_knots(path: FloatArray, knot: int, t: float) -> Vector:
    """Position between two knots.

    Args:
        path: (4 + 4 k,) see above.
        knot: number of the knot before the position, from 1.
        t: time, between those of this knot and the next, s.
    """
    a, b = 4 * knot, 4 * knot + 4
    x, y, z = path[1], path[2], path[3]
    ax, ay, az = path[a + 1] - x, path[a + 2] - y, path[a + 3] - z
    bx, by, bz = path[b + 1] - x, path[b + 2] - y, path[b + 3] - z
    nearness_a = 1.0 / sqrt(ax * ax + ay * ay + az * az)
    nearness_b = 1.0 / sqrt(bx * bx + by * by + bz * bz)
    since, span = t - path[a], path[b] - path[a]
    share = since / span
    r = 1.0 / ((1.0 - share) * nearness_a + share * nearness_b)
    r /= sin(path[0] * span)
    of_a = r * nearness_a * sin(path[0] * (span - since))
    of_b = r * nearness_b * sin(path[0] * since)
    return x + of_a * ax + of_b * bx, y + of_a * ay + of_b * by, z + of_a * az + of_b * bz


@subroutine
def point_at(path: FloatArray, t: float) -> Vector:
    """Position on a path at a time.

    Args:
        path: (4 + 4 k,) see above.
        t: time, not negative, s.
    """
    low, high = 1, len(path) // 4 - 1
    end = path[4 * high]
    if t > end:
        t = t % (2.0 * end)
        t = min(t, 2.0 * end - t)
    while high - low > 1:
        middle = (low + high) // 2
        if path[4 * middle] <= t:
            low = middle
        else:
            high = middle
    return point_between_knots(path, low, t)
