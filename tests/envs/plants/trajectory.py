"""Angles of joints that follow their commands, by integrating the equation of motion.

    dv/dt = clip((g u - v) / lag, -a (1 - f max(-v, 0)), a (1 - f max(v, 0))),   dq/dt = v

The command u of a period acts from its beginning plus the command latency on. g is its gain, and f
the fraction by which 1 rad/s reduces the greatest acceleration a. No stops, no backlash.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import solve_ivp

from vergence.models import HeadModel

Array = NDArray[np.float64]
Motion = Callable[[float], tuple[Array, Array]]
"""Angles and velocities (7,) at a time."""


def motion_of(
    head: HeadModel, commands: ArrayLike, *, start: ArrayLike = 0.0, lag_s: float | None = None,
    late_s: float = 0.0, gain: ArrayLike = 1.0, ratio: float = 1.0, falloff: float = 0.0,
) -> Motion:  # fmt: skip
    """The motion of a head whose actuators are its joints.

    Args:
        head: head with the limits and the timing.
        commands: (periods, 7) commands within the limits, rad/s.
        start: (7,) where the joints rest at first, rad.
        lag_s: another lag than the head's, s.
        late_s: from a command to the joints' response, s.
        gain: (7,) speed at rest by command.
        ratio: greatest accelerations by the head's.
        falloff: share of it that is lost at the greatest speed, gain included.
    """
    commands = np.asarray(commands, dtype=np.float64)
    gain = np.broadcast_to(np.asarray(gain, dtype=np.float64), 7)
    a, period = ratio * head.limits.acceleration, head.timing.period_s
    torque_falloff = falloff / (gain * head.limits.velocity)
    lag = head.timing.lag_s if lag_s is None else lag_s

    def slope(u: Array) -> Callable[[float, Array], Array]:
        def rates(_t: float, state: Array) -> Array:
            v = state[7:]
            up, down = (
                a * (1.0 - torque_falloff * np.maximum(side * v, 0.0)) for side in (1.0, -1.0)
            )
            return np.concatenate([v, np.clip((u - v) / lag, -down, up)])

        return rates

    state = np.concatenate([np.broadcast_to(start, 7), np.zeros(7)]).astype(float)
    begins, pieces = [0.0], []
    if late_s > 0.0:
        pieces.append(lambda _t, rest=state: rest)
        begins.append(late_s)
    for u in gain * commands:
        end = begins[-1] + period
        solved = solve_ivp(
            slope(u), (begins[-1], end), state, "DOP853", dense_output=True, rtol=1e-11, atol=1e-13
        )
        state = solved.y[:, -1]
        pieces.append(solved.sol)
        begins.append(end)

    def at(time_s: float) -> tuple[Array, Array]:
        piece = int(np.searchsorted(begins, time_s, side="right")) - 1
        now = pieces[min(max(piece, 0), len(pieces) - 1)](max(time_s, 0.0))
        return now[:7], now[7:]

    return at


def swing(count: int, period_s: float, size: float = 1.0) -> Array:
    """(count, 7) commands of the eyes that rise, fall and turn round, rad/s."""
    t = period_s * np.arange(count)[:, None]
    out = np.zeros((count, 7))
    out[:, 3:] = size * np.sin(9.0 * t + np.array([0.3, 1.2, 2.0, 4.0])) * [0.5, 0.8, -0.6, 0.7]
    return out
