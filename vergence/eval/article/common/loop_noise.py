r"""The loop's noise bandwidth: how much of the detector's noise reaches the eyes.

The model holds per eye and image axis, in pixels, if the law's Jacobian is exact. The image exposed
`d` periods ago showed the target at `x(k - d) + n(k - d)` from the principal point, with detection
noise n. The command is `u(k) = -g (x(k - d) + n(k - d))`. Over the period T the joint's velocity v
follows its command with the time constant tau,

    v(k+1) = a v(k) + (1 - a) u(k),                              a = exp(-T / tau)
    x(k+1) = x(k) + tau (1 - a) v(k) + (T - tau (1 - a)) u(k).

White noise n of unit variance drives this linear system to a stationary variance of x, the sum
of the squares of its impulse response, which solves a discrete Lyapunov equation.
"""

from dataclasses import dataclass
from math import exp

import numpy as np
from scipy.linalg import solve_discrete_lyapunov

from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray


@dataclass(frozen=True, kw_only=True)
class LinearLoop:
    """A sampled gaze loop, linearised for small signals."""

    gain: float
    """The law's gain, 1/s."""
    period_s: float
    """The control period, s; one frame is taken in each."""
    delay_periods: int
    """Control periods from exposure to reading."""
    lag_s: float
    """Time constant of the joints' velocity, s; 0 for none."""

    @staticmethod
    def of(head: HeadModel, gain: float) -> "LinearLoop":
        """The loop of a head; its frames come at the control rate."""
        timing = head.timing
        return LinearLoop(
            gain=gain,
            period_s=timing.period_s,
            delay_periods=timing.latency_frames,
            lag_s=timing.lag_s,
        )

    def at_rate(self, rate_hz: float) -> "LinearLoop":
        """This loop at another rate, its delay in seconds rounded to whole periods."""
        delay = round(self.delay_periods * self.period_s * rate_hz)
        return LinearLoop(
            gain=self.gain, period_s=1.0 / rate_hz, delay_periods=delay, lag_s=self.lag_s
        )


def _matrices(loop: LinearLoop) -> tuple[FloatArray, FloatArray]:
    """Transition matrix of the state (x(k), v(k), x(k-1), ..., x(k-d)), and noise input vector."""
    size = 2 + loop.delay_periods
    left = exp(-loop.period_s / loop.lag_s) if loop.lag_s > 0.0 else 0.0
    glide = loop.lag_s * (1.0 - left)
    drive = np.zeros(size)
    drive[0], drive[1] = loop.period_s - glide, 1.0 - left
    step = np.zeros((size, size))
    step[0, 0], step[0, 1], step[1, 1] = 1.0, glide, left
    for past in range(loop.delay_periods):
        step[2 + past, 0 if past == 0 else 1 + past] = 1.0
    seen = 0 if loop.delay_periods == 0 else size - 1
    step[:, seen] -= loop.gain * drive
    return step, -loop.gain * drive


def noise_gain(loop: LinearLoop) -> float:
    """Ratio of the optical axis' standard deviation to that of white detection noise, both in px.

    Args:
        loop: the loop.

    Returns:
        The ratio; inf for an unstable loop.
    """
    step, noise = _matrices(loop)
    if np.abs(np.linalg.eigvals(step)).max() >= 1.0:
        return float("inf")
    return float(np.sqrt(solve_discrete_lyapunov(step, np.outer(noise, noise))[0, 0]))


def impulse_response(loop: LinearLoop, steps: int) -> FloatArray:
    """Response of the optical axis to a single detection that is off by one pixel.

    Args:
        loop: the loop.
        steps: number of control periods.

    Returns:
        (steps,) px.
    """
    step, state = _matrices(loop)
    response = np.empty(steps)
    for k in range(steps):
        response[k] = state[0]
        state = step @ state
    return response


def noise_bandwidth_hz(loop: LinearLoop) -> float:
    """Equivalent noise bandwidth: bandwidth of an ideal low-pass with equal output variance, Hz."""
    return 0.5 * noise_gain(loop) ** 2 / loop.period_s
