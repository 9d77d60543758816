r"""Paths with corners: from knot to knot at one angular speed, seen from one point, in N.

A path is a flat array of fours: first (speed, x, y, z), rad/s and the point E that it is seen
from, m, then one (t, x, y, z) a knot, s and m, the first at time zero. From the knot A to the
knot B, a time T later, the line of sight from E turns along a great circle and the inverse of the
distance changes, both at a constant rate. With u the unit vectors to the knots, r their distances,
and s the time since A,

    u(s) = (sin(speed (T - s)) u_A + sin(speed s) u_B) / sin(speed T)
    1 / r(s) = (1 - s / T) / r_A + (s / T) / r_B

so u_A and u_B have to be speed T apart, less than pi. After the last knot the way leads back, and
from the first one forth again.
"""

from math import sin, sqrt
from typing import Final

from vergence._jit import device, subroutine
from vergence.models.parts import FloatArray
from vergence.models.pose import Vector

LEAST_PATH: Final = 12
"""Length of a path of two knots."""


@device
def on_stretch(path: FloatArray, knot: int, t: float) -> Vector:
    """A point between two knots.

    Args:
        path: (4 + 4 k,) see above.
        knot: that before the point, from 1.
        t: from this knot's time to that of the next, s.
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
def point_on(path: FloatArray, t: float) -> Vector:
    """Where a path is at a time.

    Args:
        path: (4 + 4 k,) see above.
        t: not negative, s.
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
    return on_stretch(path, low, t)
