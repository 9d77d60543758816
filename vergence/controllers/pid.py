r"""PID on the pixel error, mapped to the joints by the inverse image Jacobian.

Per eye and image axis, with e the undistorted pixel error of the newest image,

    r = -(kp e + ki int e dt + kd de/dt),   theta_dot = J^-1 r

The head integrates its commands, so proportional action alone leaves no error at a resting target.
The integral removes the lag behind a target of constant velocity, and the derivative compensates
the actuator's lag.

- The derivative is that of the measured error, over the time between two images that have actually
  arrived, through a first-order filter of time constant T_f. A target that has jumped counts as a
  new one: its jump is no rate, and the state is reset.
- Anti-windup by clamping: while a speed limit cuts an eye's command, its integral takes in no error
  that would drive the command farther beyond.
- An eye that has lost its target is held still and its state is reset; at an episode's start all
  are. If a detection is missed or held back as an outlier (`vergence.controllers.gate`),
  the next rate spans two images.
- Only the part of the error that the head's actuators can remove counts as e
  (`vergence.controllers.ibvs`): the rest would wind the integral up.
"""

from collections.abc import Callable
from math import isfinite
from typing import Annotated, Final, Literal

import numpy as np
from numpy.typing import ArrayLike

from vergence.controllers.gate import GatedDetections, GatedImageController
from vergence.controllers.ibvs import (
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

    def __init__(
        self,
        *,
        head: HeadModel,
        layout: ObservationLayout,
        kp: ArrayLike = 6.5,
        ki: ArrayLike = 0.002,
        kd: ArrayLike = 0.18,
        filter_s: float = 0.018,
        depth: Literal["triangulated"] | float = "triangulated",
    ) -> None:
        super().__init__(head=head, layout=layout)
        gains = as_gains("kp", kp), as_gains("ki", ki), as_gains("kd", kd)
        check_at_least_zero("filter_s", filter_s)
        self._constants = make_row(
            PID_LAW,
            gains=gains,
            filter_s=filter_s,
            period_s=layout.period_s,
            depth_m=depth_or_nan(depth),
        )
        self._depth = depth_or_nan(depth)
        self._limit = np.array(layout.action_limits)

    @property
    def _ask(self) -> Callable[..., tuple[FloatArray, FloatArray]]:
        """Kernel of the law on its packed state and constants: `pid_command` or one like it."""
        return pid_command

    def _own_initial(self) -> FloatArray:
        return make_row(PID_STATE)

    def _law(self, detections: GatedDetections, own: FloatArray) -> FloatArray:
        error, q = detections.pixel_error, detections.positions_at_exposure
        own[...], command = self._ask(
            own,
            error,
            reducible_pixel_error(self.head, q, error, self._depth),
            detections.fresh,
            detections.jumped,
            q,
            self._constants,
            self._limit,
            self.head.packed,
        )
        return np.asarray(command)


@inlined
def update_error_rates(
    s: PIDState,
    law: PIDLaw,
    error: FloatArray,
    fresh: FloatArray,
    jumped: FloatArray,
) -> tuple[float, float]:
    """Update the errors and their filtered rates.

    Args:
        s: the state.
        law: the constants.
        error: (2, 2) removable pixel errors by eye and image axis, px; nan where not visible.
        fresh: (2,) see `GatedDetections`.
        jumped: (2,) see `GatedDetections`.

    Returns:
        Time since each eye's previous detection, s; zero if no new one has arrived.
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
    s: PIDState,
    law: PIDLaw,
    gains: Gains,
    error: FloatArray,
    q: FloatArray,
    elapsed_s: tuple[float, float],
    limit: FloatArray,
    p: PackedHead,
    out: FloatArray,
) -> None:
    """Compute the velocities of the eyes' actuators, and update the integral.

    Args:
        s: the state.
        law: the constants.
        gains: the present gains.
        error: (2, 2) pixel errors by eye and image axis, px; nan where not visible.
        q: (7,) joint angles at the exposure, rad.
        elapsed_s: times returned by `update_error_rates`, s.
        limit: (4,) largest speeds of the actuators, rad/s.
        p: a packed head.
        out: (4,) result: the velocities, rad/s.
    """
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
    state_before: FloatArray,
    error: FloatArray,
    reducible_error: FloatArray,
    fresh: FloatArray,
    jumped: FloatArray,
    q: FloatArray,
    law_row: FloatArray,
    limit: FloatArray,
    p: PackedHead,
    state_after: FloatArray,
    out: FloatArray,
) -> None:
    """Compute the updated state and the velocities of the eyes' actuators."""
    for k in range(_SIZE):
        state_after[k] = state_before[k]
    s: PIDState = record_view(state_after, PID_STATE)
    law: PIDLaw = record_view(law_row, PID_LAW)
    elapsed = update_error_rates(s, law, reducible_error, fresh, jumped)
    pid_velocities(s, law, law.gains, error, q, elapsed, limit, p, out)
