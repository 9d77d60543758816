"""Warnings on implausible points: points in millimetres, or beyond the limits of the eyes."""

import warnings
from collections.abc import Sequence
from math import hypot
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from vergence.errors import VergenceWarning
from vergence.models.actuation import Actuation
from vergence.models.parts import EYES, FloatArray, JointLimits

_MM_PER_M: Final = 1000.0
"""Millimetres per metre (physical: the unit)."""
_ROUNDING_RAD: Final = 1e-9
"""Tolerance for angles at their limits, rad (numerical)."""


def limits_of_eyes(
    joints: tuple[str, ...], limits: JointLimits, actuation: Actuation
) -> list[tuple[str, float, float]]:
    """Names and least and greatest angles, rad, of the eyes' actuators, then of their joints."""
    return [
        (name, low, high)
        for names, ends in ((actuation.names, actuation), (joints[EYES], limits))
        for name, low, high in zip(
            names, ends.lower[EYES].tolist(), ends.upper[EYES].tolist(), strict=False
        )
    ]


def warn_of_point(
    point: ArrayLike,
    q: FloatArray,
    far_m: float,
    eyes: Sequence[tuple[str, float, float]],
    actuation: Actuation,
) -> None:
    """Warn of a point in millimetres or out of reach.

    No disparity tells a point beyond `far_m` from one at infinity; beyond 1000 times that it is
    taken for a star, and not for a point in millimetres.
    """
    x, y, z = np.asarray(point, dtype=np.float64).tolist()
    if far_m < hypot(x, y, z) < _MM_PER_M * far_m:
        said = (
            f"metres, got ({x:g}, {y:g}, {z:g}), which is {hypot(x, y, z):.3g} m away, where no "
            f"eye of this head tells how far (from {far_m:.0f} m on): is it in millimetres?"
        )
    elif beyond := describe_beyond_limits(eyes, actuation, q):
        said = f"a point that the eyes can turn to, got ({x:g}, {y:g}, {z:g}) m, for which {beyond}"
    else:
        return
    warnings.warn(f"fixate: points: expected {said}", VergenceWarning, stacklevel=3)


def describe_beyond_limits(
    eyes: Sequence[tuple[str, float, float]], actuation: Actuation, q: FloatArray
) -> str:
    """Phrase on the first of `limits_of_eyes` that is not kept at (7,) q; or empty."""
    angles = q.tolist()[EYES]  # floats, which are compared faster than arrays
    if not actuation.direct:
        angles = actuation.actuators_of(q).tolist()[EYES][: actuation.count] + angles
    for (name, low, high), angle in zip(eyes, angles, strict=False):
        if angle < low - _ROUNDING_RAD or angle > high + _ROUNDING_RAD:
            low, angle, high = np.rad2deg([low, angle, high])
            return f"{name} would be at {angle:.1f} degrees, outside {low:.1f} to {high:.1f}"
    return ""
