"""Warnings on implausible points: points in millimetres, or beyond the limits of the eyes."""

import warnings
from math import hypot
from operator import le
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from vergence.errors import VergenceWarning
from vergence.models.actuation import Actuation
from vergence.models.parts import EYES, FloatArray, JointLimits

_ZERO_DISPARITY_PX: Final = 0.5
"""Disparity below which a point looks as if at infinity, px: it rounds to 0 (chosen: half a
pixel)."""
_MM_PER_M: Final = 1000.0
"""Millimetres per metre (physical: the unit)."""
_ROUNDING_RAD: Final = 1e-9
"""Tolerance for angles at their limits, rad (numerical)."""


class FixationBounds(NamedTuple):
    """Limits of points and angles of `HeadModel.fixate`: floats, compared faster than arrays."""

    zero_disparity_m: float
    """Distance from which the disparity does not distinguish a point from one at infinity, m."""
    actuation: Actuation
    limits: JointLimits
    joints: tuple[str, ...]
    """(7,) names."""
    eye_lower_rad: list[float]
    """(8,) least angles of the eyes' four joints, then of their four actuators, rad."""
    eye_upper_rad: list[float]
    """(8,) greatest angles, in the same order, rad."""

    @classmethod
    def of(
        cls,
        joints: tuple[str, ...],
        limits: JointLimits,
        actuation: Actuation,
        baseline_m: float,
        focal_px: float,
    ) -> "FixationBounds":
        """Bounds of one head, from its limits, its baseline at rest and its focal length."""
        return cls(
            baseline_m * focal_px / _ZERO_DISPARITY_PX,
            actuation,
            limits,
            joints,
            (np.r_[limits.lower[EYES], actuation.lower[EYES]] - _ROUNDING_RAD).tolist(),
            (np.r_[limits.upper[EYES], actuation.upper[EYES]] + _ROUNDING_RAD).tolist(),
        )


def warn_of_point(bounds: FixationBounds, point: ArrayLike, q: FloatArray) -> None:
    """Warn of a point in millimetres (not beyond 1000 x far_m, as a star) or out of reach."""
    x, y, z = np.asarray(point, dtype=np.float64).tolist()
    distance = hypot(x, y, z)
    if bounds.zero_disparity_m < distance < _MM_PER_M * bounds.zero_disparity_m:
        said = (
            f"metres, got {_formatted(x, y, z)}, which is {distance:.3g} m away, where no eye of "
            f"this head tells how far (from {bounds.zero_disparity_m:.0f} m on): is it in "
            "millimetres?"
        )
    else:
        angles = q.tolist()[EYES]
        if not bounds.actuation.direct:
            angles += bounds.actuation.actuators_of(q).tolist()[EYES]
        if all(map(le, bounds.eye_lower_rad, angles)) and all(
            map(le, angles, bounds.eye_upper_rad)
        ):
            return
        beyond = describe_beyond_limits(bounds.joints, bounds.limits, bounds.actuation, q)
        if not beyond:
            return
        said = f"a point that the eyes can turn to, got {_formatted(x, y, z)} m, for which {beyond}"
    warnings.warn(f"fixate: points: expected {said}", VergenceWarning, stacklevel=3)


def describe_beyond_limits(
    joints: tuple[str, ...], limits: JointLimits, actuation: Actuation, q: FloatArray
) -> str:
    """Phrase on the first actuator or joint of the eyes beyond its limits at (7,) q; or empty."""
    for names, angles, ends in (
        (actuation.names, actuation.actuators_of(q), actuation),
        (joints[EYES], q, limits),
    ):
        for i, name in enumerate(names, EYES.start):
            low, angle, high = ends.lower[i], angles[i], ends.upper[i]
            if angle < low - _ROUNDING_RAD or angle > high + _ROUNDING_RAD:
                low, angle, high = np.rad2deg([low, angle, high])
                return f"{name} would be at {angle:.1f} degrees, outside {low:.1f} to {high:.1f}"
    return ""


def _formatted(*numbers: float) -> str:
    return f"({', '.join(f'{number:g}' for number in numbers)})"
