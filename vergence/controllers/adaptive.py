"""Laws with gains that vary: ViSP's adaptive gain, and gain schedules.

The adaptive gain of the law of `vergence.controllers.ibvs` grows as the error shrinks. Per eye,

    lambda(x) = (lambda_0 - lambda_inf) exp(-lambda'_0 x / |lambda_0 - lambda_inf|) + lambda_inf

with lambda_0 the gain at zero error, lambda_inf the gain far away, and -lambda'_0 the slope at zero
(`vpAdaptiveGain` of ViSP). If lambda_inf is the larger one, the gain rises with that slope instead.
x is the infinity norm of the eye's error in normalised image coordinates, (u - u_0) / f_u and (v -
v_0) / f_v: no unit, close to radians near the axis. Only the part of the error that the head's
actuators can remove counts.

A schedule chooses K of the law `theta_dot = J^-1 K (p* - p)` for each eye and image axis, between 0
and 20 per second. Whatever the gains, the eyes never turn away from the target's position in the
newest image, and they rest where that error is zero.

An action of a schedule is four numbers in [-1, 1], whatever moves the head's eyes: one per eye and
image axis, in the order of `gain_names_of_head`.

    gain = 5 (1 + action)^2 per second

The square gives small gains, which brake, a larger part of the range.
"""

from collections.abc import Sequence
from math import exp, isfinite
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from vergence.controllers.gate import GatedDetections, GatedImageController
from vergence.controllers.ibvs import (
    Depth,
    depth_or_nan,
    ibvs_velocities,
    reducible_pixel_error,
    speed_limits,
)
from vergence.envs.observation import ObservationLayout
from vergence.envs.reading import check_at_least_zero
from vergence.kernels import kernel
from vergence.models.head import HeadModel
from vergence.models.kinematics import PACKED, PackedHead, camera_of
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.operands import as_operand


class AdaptiveIBVS(GatedImageController):
    """IBVS whose gain depends on the size of each eye's error.

    Args:
        head: the model of the head.
        layout: the layout of observations and actions.
        lambda_zero: gain at zero error, 1/s.
        lambda_inf: gain at large errors, 1/s; if it equals `lambda_zero` the gain is fixed.
        slope_zero: lambda'_0, steepness of the gain's fall at zero error, 1/s per unit of x.
        depth, speed_limit: see `IBVS`.

    Raises:
        ConfigurationError: an option has an invalid value.
    """

    def __init__(
        self, *, head: HeadModel, layout: ObservationLayout,
        lambda_zero: float = 4.2, lambda_inf: float = 4.1, slope_zero: float = 30.0,
        depth: Depth = "triangulated", speed_limit: float | None = None,
    ) -> None:  # fmt: skip
        values = {"lambda_zero": lambda_zero, "lambda_inf": lambda_inf, "slope_zero": slope_zero}
        for name, value in values.items():
            check_at_least_zero(name, value)
        super().__init__(head=head, layout=layout)
        self._depth = depth_or_nan(depth)
        self._limit = speed_limits(layout, speed_limit)
        self._constants = np.array([lambda_zero, lambda_inf, slope_zero])

    def gains(self, pixel_error: ArrayLike) -> FloatArray:
        """Compute the (..., 2, 2) gains, 1/s, for (..., 2, 2) errors, px, by eye and image axis."""
        return np.asarray(adaptive_gains(pixel_error, self._constants, self.head.packed))

    def command(self, q: ArrayLike, pixel_error: ArrayLike) -> FloatArray:
        """Compute the velocities of the law, see `IBVS.command`."""
        error = as_operand("pixel_error", pixel_error, 2, 2)
        gains = self.gains(reducible_pixel_error(self.head, q, error, self._depth))
        return ibvs_velocities(self.head, q, error, gains, self._depth, self._limit)

    def _law(self, detections: GatedDetections, own: FloatArray) -> FloatArray:
        return self.command(detections.positions_at_exposure, detections.pixel_error)


@kernel(["(f8[:,:],f8[:],f8[:],f8[:,:])"], f"(2,2),(3),({PACKED})->(2,2)")
def adaptive_gains(
    pixel_error: FloatArray, law: FloatArray, p: PackedHead, out: FloatArray
) -> None:
    """Compute gains from pixel errors; `law` is (lambda_0, lambda_inf, lambda'_0)."""
    zero, far, slope = law[0], law[1], law[2]
    fall = zero - far
    for eye in range(2):
        gain, du, dv = far, abs(pixel_error[eye, 0]), abs(pixel_error[eye, 1])
        # the exponential vanishes in the limit lambda_0 = lambda_inf
        if fall != 0.0 and isfinite(du) and isfinite(dv):
            camera = camera_of(p, eye)
            x = max(du / camera.focal_u, dv / camera.focal_v)
            gain += fall * exp(-slope * x / abs(fall))
        out[eye, 0] = out[eye, 1] = gain


GAIN_LIMIT: Final = 20.0
"""Largest gain, 1/s; the least is 0 (chosen)."""
TILT_FIRST_GAIN_NAMES: Final = ("left_v", "left_u", "right_v", "right_u")
"""Gains of the four numbers of a schedule's action, for eyes that tilt first."""


def gain_names_of_head(head: HeadModel) -> tuple[str, ...]:
    """Name the four gains of a schedule's action in its order: eye, image axis (`left_v`).

    With a motor per joint, the axis is the one that each joint moves most at rest, in joint order;
    for any other head the names are `TILT_FIRST_GAIN_NAMES`.
    """
    if not head.actuation.direct:
        return TILT_FIRST_GAIN_NAMES
    moved = np.abs(head.image_jacobian(head.rest(), head.cameras.principal, np.ones(2)))
    names: list[str] = []
    for eye, name in enumerate(EYE_NAMES):
        (u1, u2), (v1, v2) = moved[eye, :, 3 + 2 * eye : 5 + 2 * eye]
        axes = "uv" if u1 + v2 > v1 + u2 else "vu"
        names += [f"{name}_{axis}" for axis in axes]
    return tuple(names)


def gain_indices_by_axis(gain_names: Sequence[str] = TILT_FIRST_GAIN_NAMES) -> list[int]:
    """Return the index in `gain_names_of_head` of the gain of each eye and image axis (u, v)."""
    return [gain_names.index(f"{eye}_{axis}") for eye in EYE_NAMES for axis in "uv"]


def gains_from_action(
    action: ArrayLike, names: Sequence[str] = TILT_FIRST_GAIN_NAMES
) -> FloatArray:
    """Compute the (..., 2, 2) gains, 1/s, of a schedule's (..., 4) action in the order of `names`.

    The action is limited to [-1, 1]; the gains are by eye and image axis (u, v).
    """
    share = 0.5 * (1.0 + np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0))
    gains = GAIN_LIMIT * share[..., gain_indices_by_axis(names)] ** 2
    return np.ascontiguousarray(gains).reshape(*share.shape[:-1], 2, 2)
