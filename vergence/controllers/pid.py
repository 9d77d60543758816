"""PID on the pixel error, mapped to the joints by the inverse image Jacobian.

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

Fuzzy PID, as the article proposes, has gains that follow the error and its rate by rules. With e
scaled by its universe E and de/dt by D to [-1, 1], each is a member of seven triangular sets NB NM
NS ZO PS PM PB (negative and positive, big, medium, small, and zero), evenly spaced, so that
neighbours' memberships add up to 1. A rule "if e is A and de/dt is B" fires with the product of its
two memberships (Sugeno, order zero), and the weighted average of the rules' singletons, NB = -1 to
PB = 1 in thirds, gives

    kp = kp0 (1 + mu_p Delta_p),   ki = ki0 (1 + mu_i Delta_i),   kd = kd0 (1 + mu_d Delta_d)

mu is at most 1, so a gain is never negative. The rules (`RULES`) are symmetric, Delta(-e, -de/dt) =
Delta(e, de/dt), as left and right are alike.
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
from vergence.envs.reading import check_above_zero, check_at_least_zero, check_finite_number
from vergence.errors import ConfigurationError
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


FUZZY_SETS: Final = ("NB", "NM", "NS", "ZO", "PS", "PM", "PB")
"""The sets of error, rate and change of gain, from -1 to 1 in thirds."""

RULES: Final = {
    "kp": (
        "NM NS ZO ZO ZO NS NM",  # at the target: do not feed noise and swing
        "NB NM NS ZO PS PM PB",  # close, and coming in fast: brake; else push
        "NM NS ZO PS PM PB PB",
        "ZO PS PM PB PB PB PB",  # far away: go
    ),
    "ki": (
        "NB NM PS PB PS NM NB",  # integrate what stays, not what passes
        "NB NM NS PM PM PS ZO",
        "NB NB NM NS NS NM NB",
        "NB NB NB NB NB NB NB",  # far away an integral only winds up
    ),
    "kd": (
        "PB PM PS ZO PS PM PB",  # swinging through the target: damp
        "PB PB PM PS ZO NS NS",  # coming in fast: damp more
        "PM PM PS ZO NS NM NM",
        "ZO ZO NS NM NB NB NB",  # far away: do not hold back
    ),
}
"""Changes of gain by error and rate: rows from ZO to PB, mirrored for negative errors; columns from
NB (it approaches fast) to PB (it recedes fast)."""


def rule_base() -> FloatArray:
    """(3, 7, 7) changes of kp, ki and kd by set of the error and set of its rate, -1 to 1."""
    value = {name: (i - 3) / 3.0 for i, name in enumerate(FUZZY_SETS)}
    half = np.array([[[value[word] for word in row.split()] for row in RULES[k]] for k in RULES])
    return np.concatenate([half[:, :0:-1, ::-1], half], axis=1)


class FuzzyState:
    """State of the law for one head, with its present gains."""

    pid: PIDState
    gains: Gains


class FuzzyLaw:
    """Constants of the law; the gains of the PID are kp0, ki0 and kd0."""

    pid: PIDLaw
    factors: Annotated[FloatArray, 3, 7, 7]
    """Factors of kp, ki and kd by set of the error and set of its rate."""
    error_px: float
    rate_px_s: float


FUZZY_STATE: Final = row_layout(FuzzyState)
_FUZZY_SIZE: Final = row_size(FUZZY_STATE)
FUZZY_LAW: Final = row_layout(FuzzyLaw)


@inlined
def _sets(x: float) -> tuple[int, float]:
    """Return the lower of the two sets of a scaled value, and the membership of the upper one."""
    place = 3.0 * (min(max(x, -1.0), 1.0) + 1.0)
    lower = min(int(place), 5)
    return lower, place - lower


@inlined
def _infer(error: float, rate: float, law: FuzzyLaw, gain: int) -> float:
    """Average the four rules that fire, weighted by memberships that add up to 1."""
    row, a = _sets(error / law.error_px)
    column, b = _sets(rate / law.rate_px_s)
    table = law.factors[gain]
    average: float = (
        (1.0 - a) * (1.0 - b) * table[row, column]
        + (1.0 - a) * b * table[row, column + 1]
        + a * (1.0 - b) * table[row + 1, column]
        + a * b * table[row + 1, column + 1]
    )
    return average


@kernel(["(f8[:],f8[:],f8[:],f8[:],f8[:])"], f"(),(),({row_size(FUZZY_LAW)}),(3)->(3)")
def fuzzy_gain_factors(
    error: FloatArray, rate: FloatArray, law_row: FloatArray, _three: FloatArray, out: FloatArray
) -> None:
    """Compute the factors of kp, ki and kd; any `_three` sets the length of the result."""
    law: FuzzyLaw = record_view(law_row, FUZZY_LAW)
    for gain in range(3):
        out[gain] = _infer(error[0], rate[0], law, gain)


@kernel(
    ["(f8[:],f8[:,:],f8[:,:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:])"],
    f"({_FUZZY_SIZE}),(2,2),(2,2),(2),(2),(7),({row_size(FUZZY_LAW)}),(4),({PACKED})->({_FUZZY_SIZE}),(4)",
)
def fuzzy_command(
    state_before: FloatArray, error: FloatArray, reducible_error: FloatArray, fresh: FloatArray,
    jumped: FloatArray, q: FloatArray, law_row: FloatArray, limit: FloatArray, p: PackedHead,
    state_after: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    """Compute the updated state and the velocities of the eyes' actuators."""
    for k in range(_FUZZY_SIZE):
        state_after[k] = state_before[k]
    state: FuzzyState = record_view(state_after, FUZZY_STATE)
    law: FuzzyLaw = record_view(law_row, FUZZY_LAW)
    s, gains, basic = state.pid, state.gains, law.pid.gains
    elapsed = update_error_rates(s, law.pid, reducible_error, fresh, jumped)
    for eye in range(2):
        for axis in range(2):
            e, rate = s.error[eye, axis], s.rate[eye, axis]
            gains.kp[eye, axis] = basic.kp[eye, axis] * _infer(e, rate, law, 0)
            gains.ki[eye, axis] = basic.ki[eye, axis] * _infer(e, rate, law, 1)
            gains.kd[eye, axis] = basic.kd[eye, axis] * _infer(e, rate, law, 2)
    pid_velocities(s, law.pid, gains, error, q, elapsed, limit, p, out)


class FuzzyPID(PID):
    """PID with gains from fuzzy rules on the error and its rate.

    Args:
        head: the model of the head.
        layout: the layout of observations and actions.
        kp, ki, kd: kp0, ki0 and kd0, see `PID`.
        span_p, span_i, span_d: mu_p, mu_i and mu_d, 0 to 1.
        error_px: E, the error at full membership of the sets NB and PB, px.
        rate_px_s: D, the rate at full membership of the sets NB and PB, px/s.
        filter_s, depth: see `PID`.

    Raises:
        ConfigurationError: an option has an invalid value.
    """

    _kernel: ClassVar[Any] = fuzzy_command

    def __init__(
        self, *, head: HeadModel, layout: ObservationLayout,
        kp: ArrayLike = 7.0, ki: ArrayLike = 0.01, kd: ArrayLike = 0.195,
        span_p: float = 0.08, span_i: float = 0.5, span_d: float = 0.05,
        error_px: float = 160.0, rate_px_s: float = 560.0, filter_s: float = 0.011,
        depth: Depth = "triangulated",
    ) -> None:  # fmt: skip
        super().__init__(
            head=head, layout=layout, kp=kp, ki=ki, kd=kd, filter_s=filter_s, depth=depth
        )
        for name, value in {"span_p": span_p, "span_i": span_i, "span_d": span_d}.items():
            if not 0.0 <= check_finite_number(name, value) <= 1.0:
                raise ConfigurationError(f"{name}: expected 0 to 1, got {value!r}")
        check_above_zero("error_px", error_px)
        check_above_zero("rate_px_s", rate_px_s)
        spans = np.array([span_p, span_i, span_d])
        self.universe = (error_px, rate_px_s)
        """Error E, px, and rate D, px/s, at full membership of the sets NB and PB."""
        factors = 1.0 + spans[:, None, None] * rule_base()
        self._constants = make_row(
            FUZZY_LAW, pid=self._constants.view(PID_LAW), factors=factors,
            error_px=error_px, rate_px_s=rate_px_s,
        )  # fmt: skip

    def _own_initial(self) -> FloatArray:
        return make_row(FUZZY_STATE, pid=super()._own_initial().view(PID_STATE))

    def factors(self, error: ArrayLike, rate: ArrayLike) -> FloatArray:
        """Compute the (..., 3) factors of kp, ki and kd for errors (...), px, and rates, px/s."""
        return np.asarray(fuzzy_gain_factors(error, rate, self._constants, np.zeros(3)))
