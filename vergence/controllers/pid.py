r"""PID on the pixel error, mapped to the joints by the inverse image Jacobian.

Per eye and image axis, with e the reducible pixel error (`vergence.controllers.ibvs`),

    r = -(kp e + ki int e dt + kd de/dt),   theta_dot = J^-1 r

The head integrates its commands, so proportional action alone leaves no error at a resting target.
The integral removes the lag behind a target of constant velocity, and the derivative compensates
the actuator's lag.

- The derivative spans the time between two images that have actually arrived, through a first-order
  filter of time constant T_f. A target that has jumped counts as a new one: its jump is no rate.
- Anti-windup by clamping: while a speed limit cuts an eye's command, its integral takes in no error
  that would drive the command farther beyond.
- An eye that has lost its target, or whose target has jumped, starts anew.
"""

from math import isfinite
from typing import Annotated, Any, ClassVar, Final

import numpy as np
from numpy.typing import ArrayLike

from vergence.controllers.gate import GatedDetections, GatedImageController
from vergence.controllers.ibvs import (
    Depth,
    as_gains,
    depth_or_nan,
    limited_actuator_velocities,
    limited_joint_velocities,
    reducible_pixel_error,
)
from vergence.envs.observation import ObservationLayout
from vergence.envs.reading import check_at_least_zero
from vergence.kernels import inlined, kernel, make_row, record_view, row_layout, row_size
from vergence.models.head import HeadModel
from vergence.models.kinematics import PACKED, PackedHead, has_motor_per_joint
from vergence.models.parts import FloatArray


class PIDState:
    """State of the law for one head; arrays are by eye and image axis."""

    integral: Annotated[FloatArray, 2, 2]
    """ki int e dt, px/s."""
    error: Annotated[FloatArray, 2, 2]
    """Error of the newest detection, px; 0 if the eye has lost its target."""
    rate: Annotated[FloatArray, 2, 2]
    """Filtered rate of the error, px/s."""
    seen: Annotated[FloatArray, 2]
    """1 if the eye sees the target, otherwise 0."""
    elapsed_s: Annotated[FloatArray, 2]
    """Time since each eye's newest detection arrived, s."""


class Gains:
    """Gains of the three actions, by eye and image axis."""

    kp: Annotated[FloatArray, 2, 2]
    ki: Annotated[FloatArray, 2, 2]
    kd: Annotated[FloatArray, 2, 2]


class PIDLaw:
    """Constants of the law."""

    gains: Gains
    filter_s: float
    period_s: float
    depth_m: float
    """A constant depth, m; nan to triangulate it."""


PID_STATE: Final = row_layout(PIDState)
_SIZE: Final = row_size(PID_STATE)
PID_LAW: Final = row_layout(PIDLaw)


@inlined
def update_error_rates(
    s: PIDState, law: PIDLaw, error: FloatArray, fresh: FloatArray, jumped: FloatArray
) -> tuple[float, float]:
    """Update errors and filtered rates; return the time since each eye's last detection, s.

    The time is zero if no new detection has arrived. The errors are the reducible ones, px.
    """
    left_s = _take_in_eye(s, law, 0, error, fresh[0], jumped[0])
    return left_s, _take_in_eye(s, law, 1, error, fresh[1], jumped[1])


@inlined
def _take_in_eye(
    s: PIDState, law: PIDLaw, eye: int, error: FloatArray, fresh: float, jumped: float
) -> float:
    s.elapsed_s[eye] += law.period_s
    if fresh < 0.5:
        return 0.0
    dt: float = s.elapsed_s[eye]
    s.elapsed_s[eye] = 0.0
    du, dv = error[eye, 0], error[eye, 1]
    seen = isfinite(du) and isfinite(dv)
    known = seen and s.seen[eye] > 0.5 and jumped < 0.5
    for axis in range(2):
        value = error[eye, axis]
        if known:
            share = dt / (law.filter_s + dt)
            rate = (value - s.error[eye, axis]) / dt
            s.rate[eye, axis] += share * (rate - s.rate[eye, axis])
        else:
            s.rate[eye, axis] = s.integral[eye, axis] = 0.0
        s.error[eye, axis] = value if seen else 0.0
    s.seen[eye] = 1.0 if seen else 0.0
    return dt


@inlined
def _asked(s: PIDState, gains: Gains, eye: int, axis: int) -> float:
    """Image velocity that the three actions ask for, px/s."""
    asked: float = -(
        gains.kp[eye, axis] * s.error[eye, axis]
        + s.integral[eye, axis]
        + gains.kd[eye, axis] * s.rate[eye, axis]
    )
    return asked


@inlined
def pid_velocities(
    s: PIDState, law: PIDLaw, gains: Gains, error: FloatArray, q: FloatArray,
    elapsed_s: tuple[float, float], limit: FloatArray, p: PackedHead, out: FloatArray,
) -> None:  # fmt: skip
    """Compute the (4,) velocities of the actuators, rad/s, and add the errors to the integral."""
    for eye in range(2):
        for axis in range(2):
            out[2 * eye + axis] = _asked(s, gains, eye, axis)
    if has_motor_per_joint(p):
        excess_l, excess_r = limited_joint_velocities(p, q, error, law.depth_m, limit, out)
    else:
        excess_l = excess_r = limited_actuator_velocities(p, q, error, law.depth_m, limit, out)
    for eye in range(2):
        dt = elapsed_s[0] if eye == 0 else elapsed_s[1]
        limited = (excess_l if eye == 0 else excess_r) > 1.0
        for axis in range(2):
            e = s.error[eye, axis]
            # an error and the image velocity that it requests have opposite signs
            if not (limited and _asked(s, gains, eye, axis) * e < 0.0):
                s.integral[eye, axis] += dt * gains.ki[eye, axis] * e


@kernel(
    ["(f8[:],f8[:,:],f8[:,:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:])"],
    f"({_SIZE}),(2,2),(2,2),(2),(2),(7),({row_size(PID_LAW)}),(4),({PACKED})->({_SIZE}),(4)",
)
def pid_command(
    state_before: FloatArray, error: FloatArray, reducible_error: FloatArray, fresh: FloatArray,
    jumped: FloatArray, q: FloatArray, law_row: FloatArray, limit: FloatArray, p: PackedHead,
    state_after: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    """Compute the updated state and the velocities of the eyes' actuators."""
    for k in range(_SIZE):
        state_after[k] = state_before[k]
    s: PIDState = record_view(state_after, PID_STATE)
    law: PIDLaw = record_view(law_row, PID_LAW)
    elapsed = update_error_rates(s, law, reducible_error, fresh, jumped)
    pid_velocities(s, law, law.gains, error, q, elapsed, limit, p, out)


class PID(GatedImageController):
    """PID on pixel errors, by eye and image axis.

    Args:
        head: the model of the head.
        layout: the layout of observations and actions.
        kp: proportional gain, 1/s: a number, a pair for u and v, or (2, 2) by eye and axis.
        ki: integral gain, 1/s^2, likewise.
        kd: derivative gain, likewise, without unit.
        filter_s: T_f, time constant of the derivative's filter, s.
        depth: see `IBVS`.

    Raises:
        ConfigurationError: an option has an invalid value.
    """

    _kernel: ClassVar[Any] = pid_command

    def __init__(
        self, *, head: HeadModel, layout: ObservationLayout,
        kp: ArrayLike = 6.5, ki: ArrayLike = 0.002, kd: ArrayLike = 0.18, filter_s: float = 0.018,
        depth: Depth = "triangulated",
    ) -> None:  # fmt: skip
        super().__init__(head=head, layout=layout)
        gains = as_gains("kp", kp), as_gains("ki", ki), as_gains("kd", kd)
        check_at_least_zero("filter_s", filter_s)
        self._depth = depth_or_nan(depth)
        self._constants = make_row(
            PID_LAW, gains=gains, filter_s=filter_s, period_s=layout.period_s, depth_m=self._depth
        )
        self._limit = np.array(layout.action_limits)

    def _own_initial(self) -> FloatArray:
        return make_row(PID_STATE)

    def _law(self, detections: GatedDetections, own: FloatArray) -> FloatArray:
        error, q = detections.pixel_error, detections.positions_at_exposure
        reducible = reducible_pixel_error(self.head, q, error, self._depth)
        own[...], command = self._kernel(
            own, error, reducible, detections.fresh, detections.jumped, q,
            self._constants, self._limit, self.head.packed,
        )  # fmt: skip
        return np.asarray(command)
