"""Warnings on implausible points: points in millimetres, or beyond the limits of the eyes."""

import warnings
from math import hypot
from operator import le
from typing import Final

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


class FixationBounds:
    """Limits of points and angles of `HeadModel.fixate`: floats, compared faster than arrays."""

    def __init__(
        self,
        joints: tuple[str, ...],
        limits: JointLimits,
        actuation: Actuation,
        baseline_m: float,
        focal_px: float,
    ) -> None:
        self._joints, self._limits, self._actuation = joints, limits, actuation
        # no disparity tells a point farther off from one at infinity
        self._zero_disparity_m = baseline_m * focal_px / _ZERO_DISPARITY_PX
        # of the eyes' four joints, then of their four actuators
        lower, upper = (
            np.r_[getattr(limits, end)[EYES], getattr(actuation, end)[EYES]]
            for end in ("lower", "upper")
        )
        self._lower = (lower - _ROUNDING_RAD).tolist()
        self._upper = (upper + _ROUNDING_RAD).tolist()

    def warn_of_point(self, point: ArrayLike, q: FloatArray) -> None:
        """Warn of a point in millimetres (not beyond 1000 x far_m, as a star) or out of reach."""
        x, y, z = np.asarray(point, dtype=np.float64).tolist()
        distance, said_point = hypot(x, y, z), f"({x:g}, {y:g}, {z:g})"
        if self._zero_disparity_m < distance < _MM_PER_M * self._zero_disparity_m:
            said = (
                f"metres, got {said_point}, which is {distance:.3g} m away, where no eye of this "
                f"head tells how far (from {self._zero_disparity_m:.0f} m on): is it in "
                "millimetres?"
            )
        else:
            angles = q.tolist()[EYES]
            if not self._actuation.direct:
                angles += self._actuation.actuators_of(q).tolist()[EYES]
            if all(map(le, self._lower, angles)) and all(map(le, angles, self._upper)):
                return
            beyond = describe_beyond_limits(self._joints, self._limits, self._actuation, q)
            if not beyond:
                return
            said = f"a point that the eyes can turn to, got {said_point} m, for which {beyond}"
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
