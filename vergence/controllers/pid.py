r"""PID on the pixel error, mapped to the joints by the inverse image Jacobian.

Per eye and image axis, with e the undistorted pixel error of the newest image,

    r = -(kp e + ki int e dt + kd de/dt),   theta_dot = J^-1 r

The head integrates its commands, so proportional action alone leaves no error at a target at
rest; the integral takes away the lag behind one that moves at constant speed, and the derivative
makes up for the actuator's lag.

- The derivative is that of the measured error, over the time between two images that have
  really come, through a first-order filter of time constant T_f. A target that jumps farther
  than the joints could move the image is a new one: its jump is no rate, and all memory is
  forgotten.
- Anti-windup by clamping: while a joint's limit cuts an eye's command, its integral takes in no
  error that would drive the command farther beyond.
- An eye that does not see its target is held and forgets; so do all at an episode's start.
"""

from math import isfinite
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import ArrayLike

from vergence._jit import device, kernel
from vergence.controllers.ibvs import as_depth, as_gains, joints_of_image
from vergence.controllers.stateful import StatefulController
from vergence.envs.layout import AGE_S, Observation, ObservationLayout
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.packed import camera_of
from vergence.models.parts import FloatArray

JUMP: Final = 1.5
"""An image that moves by this factor faster than the joints' speeds allow shows a new target."""

# the state: integral term, last error and rate by eye and image axis; whether an eye saw; timing
INTEGRAL: Final = 0
LAST: Final = 4
RATE: Final = 8
SEEN: Final = 12
ELAPSED: Final = 14
AGE: Final = 15
MEMORY: Final = 16
"""Length of the state."""

FILTER_S: Final = 0
PERIOD: Final = 1
DEPTH: Final = 2
TIMING: Final = 3
"""Length of a row of the loop's constants."""


class PID(StatefulController):
    """PID in the image, by eye and image axis.

    Args:
        head: the model of the head.
        layout: the layout of observations and actions.
        kp: proportional gain, 1/s: a number, a pair for u and v, or (2, 2) by eye and axis.
        ki: integral gain, 1/s^2, likewise.
        kd: derivative gain, likewise, no unit.
        filter_s: T_f, the derivative's filter, s.
        depth: see `IBVS`.

    Raises:
        ConfigurationError: an option has a value that cannot be.
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
        self._gains = np.stack([as_gains("kp", kp), as_gains("ki", ki), as_gains("kd", kd)])
        self._timing = _timing_of(layout, filter_s, depth)
        self._limit = np.array(layout.action_limits)

    def _initial(self) -> FloatArray:
        return np.zeros(MEMORY)

    def _command(self, seen: Observation, state: FloatArray) -> FloatArray:
        state[...], command = pid_command(
            state,
            seen.pixel_error,
            seen.image_age_s,
            seen.positions_at_exposure,
            self._gains,
            self._timing,
            self._limit,
            self.head.packed,
        )
        return np.asarray(command)


def _timing_of(layout: ObservationLayout, filter_s: float, depth: str | float) -> FloatArray:
    """The row of the loop's constants.

    Raises:
        ConfigurationError: a value cannot be.
    """
    if not (isfinite(filter_s) and filter_s >= 0.0):
        raise ConfigurationError(f"filter_s: expected seconds >= 0, got {filter_s!r}")
    return np.array([filter_s, layout.period_s, as_depth(depth)])


@device
def take_in(s: Any, error: Any, age: float, timing: Any, limit: Any, p: Any) -> float:
    """Bring the last errors and their filtered rates up to date.

    Returns:
        The time since the image before, s; zero where no new one has come.
    """
    period = timing[PERIOD]
    s[ELAPSED] += period
    # an image that has not been replaced is older by a period than the last time
    fresh = (s[AGE] == 0.0 or age < s[AGE] + 0.5 * period) and age < AGE_S
    s[AGE] = age
    if not fresh:
        return 0.0
    dt: float = s[ELAPSED]
    s[ELAPSED] = 0.0
    for eye in range(2):
        camera = camera_of(p, eye)
        du, dv = error[eye, 0], error[eye, 1]
        k = 2 * eye
        seen = isfinite(du) and isfinite(dv)
        known = seen and s[SEEN + eye] > 0.5
        if known:
            fastest = JUMP * max(limit[k], limit[k + 1]) * max(camera.focal_u, camera.focal_v) * dt
            known = max(abs(du - s[LAST + k]), abs(dv - s[LAST + k + 1])) <= fastest
        for axis in range(2):
            value = du if axis == 0 else dv
            j = k + axis
            if known:
                share = dt / (timing[FILTER_S] + dt)
                s[RATE + j] += share * ((value - s[LAST + j]) / dt - s[RATE + j])
            else:
                s[RATE + j] = s[INTEGRAL + j] = 0.0
            s[LAST + j] = value if seen else 0.0
        s[SEEN + eye] = 1.0 if seen else 0.0
    return dt


@device
def act(
    s: Any, error: Any, q: Any, gains: Any, dt: float, timing: Any, limit: Any, p: Any, out: Any
) -> None:
    """The law: `gains` holds (kp, ki, kd) by eye and image axis."""
    for eye in range(2):
        for axis in range(2):
            j = 2 * eye + axis
            out[j] = -(
                gains[0, eye, axis] * s[LAST + j]
                + s[INTEGRAL + j]
                + gains[2, eye, axis] * s[RATE + j]
            )
    r0, r1, r2, r3 = out[0], out[1], out[2], out[3]
    excess_l, excess_r = joints_of_image(p, q, error, timing[DEPTH], limit, out)
    if dt == 0.0:
        return
    for eye in range(2):
        limited = (excess_l if eye == 0 else excess_r) > 1.0
        for axis in range(2):
            j = 2 * eye + axis
            r = (r0 if axis == 0 else r1) if eye == 0 else (r2 if axis == 0 else r3)
            # an error and the image velocity that it asks for have opposite signs
            if not (limited and r * s[LAST + j] < 0.0):
                s[INTEGRAL + j] += dt * gains[1, eye, axis] * s[LAST + j]


@kernel(
    ["(f8[:],f8[:,:],f8[:],f8[:],f8[:,:,:],f8[:],f8[:],f8[:],f8[:],f8[:])"],
    "(s),(e,e),(),(j),(g,e,e),(t),(a),(p)->(s),(a)",
)
def pid_command(
    before: Any, error: Any, age: Any, q: Any, gains: Any, timing: Any, limit: Any, p: Any,
    s: Any, out: Any,
) -> None:  # fmt: skip
    """Memory brought up to date, and velocities of the eyes' joints."""
    for k in range(MEMORY):
        s[k] = before[k]
    dt = take_in(s, error, age[0], timing, limit, p)
    act(s, error, q, gains, dt, timing, limit, p, out)
