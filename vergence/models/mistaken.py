"""Points that a person hardly means: those in millimetres, and those beyond the eyes' limits."""

import warnings
from math import hypot
from operator import le
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from vergence.errors import VergenceWarning
from vergence.models.actuation import Actuation
from vergence.models.joints import EYES
from vergence.models.parts import FloatArray, JointLimits

_UNSEEN_PX: Final = 0.5
"""A disparity below this rounds to none: both images show a point as if it were at infinity."""
_MM: Final = 1000.0
_ROUNDING_RAD: Final = 1e-9


class Bounds(NamedTuple):
    """Limits of the points that `HeadModel.fixate` is asked for, and of its answers.

    They are Python's numbers, as comparing eight of these takes less time than one NumPy call.
    """

    far_m: float
    """From this distance on, no disparity tells a point from one at infinity."""
    actuation: Actuation
    limits: JointLimits
    joints: tuple[str, ...]
    """(7,) names."""
    lower: list[float]
    """(8,) of the joints of the eyes and of their actuators, rad."""
    upper: list[float]

    @classmethod
    def of(
        cls,
        joints: tuple[str, ...],
        limits: JointLimits,
        actuation: Actuation,
        baseline_m: float,
        focal_px: float,
    ) -> "Bounds":
        """The bounds of one head, whose cameras are `baseline_m` apart at rest."""
        return cls(
            baseline_m * focal_px / _UNSEEN_PX,
            actuation,
            limits,
            joints,
            (np.r_[limits.lower[EYES], actuation.lower[EYES]] - _ROUNDING_RAD).tolist(),
            (np.r_[limits.upper[EYES], actuation.upper[EYES]] + _ROUNDING_RAD).tolist(),
        )


def warn_of_point(bounds: Bounds, point: ArrayLike, q: FloatArray) -> None:
    """Warn the caller's caller of a point that looks like millimetres or is beyond the limits.

    Points that are farther still are silent, as in millimetres too they would be far: stars.

    Args:
        bounds: the head's.
        point: (3,) in N, m.
        q: (7,) joint angles that fixate it, rad; nan warns of itself.
    """
    x, y, z = np.asarray(point, dtype=np.float64).tolist()
    distance = hypot(x, y, z)
    if bounds.far_m < distance < _MM * bounds.far_m:
        said = (
            f"metres, got {_plain(x, y, z)}, which is {distance:.3g} m away, where no eye of this "
            f"head tells how far (from {bounds.far_m:.0f} m on): is it in millimetres?"
        )
    else:
        angles = q.tolist()[EYES]
        if not bounds.actuation.direct:
            angles += bounds.actuation.actuators_of(q).tolist()[EYES]
        if all(map(le, bounds.lower, angles)) and all(map(le, angles, bounds.upper)):
            return
        beyond = beyond_limits(bounds.joints, bounds.limits, bounds.actuation, q)
        if not beyond:
            return
        said = f"a point that the eyes can turn to, got {_plain(x, y, z)} m, for which {beyond}"
    warnings.warn(f"fixate: points: expected {said}", VergenceWarning, stacklevel=3)


def beyond_limits(
    joints: tuple[str, ...], limits: JointLimits, actuation: Actuation, q: FloatArray
) -> str:
    """Which of the eyes' actuators or joints would be beyond its limits, in words.

    Args:
        joints: (7,) their names.
        limits: of the joints.
        actuation: the head's.
        q: (7,) joint angles, rad.

    Returns:
        Such as `left_pan would be at 60.0 degrees, outside -54.0 to 54.0`; empty for none.
    """
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


def _plain(*numbers: float) -> str:
    return f"({', '.join(f'{number:g}' for number in numbers)})"
