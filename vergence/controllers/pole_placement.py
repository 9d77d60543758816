r"""A linear law that turns an actuator to its goal and damps the oscillation of a servo's own loop.

An actuator follows its command by `m l^2 dw/dt + l w + v = u`, see
`vergence.controllers.prediction.response`. The law

    u = k (e - l' v - m l^2 w) - (l' - l) w,   l' = max(l, 2 d sqrt(m) l)

places three poles: one at the rate k, and two at the servo's own natural frequency, with a damping
ratio of at least d. If k is fast for the servo, it overshoots the goal by up to one or two percent
of the angle. With m = 0 the law reduces to `u = k (e - l v)`.
"""

from math import sqrt
from typing import Final

from vergence.kernels import inlined

_DAMPING: Final = 0.8
"""d, least damping ratio of the servo's poles (chosen: oscillation against speed)."""


@inlined
def pole_placement_command(
    angle_error: float, v: float, w: float, pole_rate: float, lag_s: float, build_up: float
) -> float:
    """Compute the command of the law, rad/s.

    Args:
        angle_error: angle to the goal, rad.
        v: velocity, rad/s.
        w: acceleration, rad/s^2.
        pole_rate: rate k of the pole that approaches the goal, 1/s.
        lag_s: lag l of the actuator, s.
        build_up: build-up m of the lag; 0 for a first-order lag.
    """
    damped = max(lag_s, 2.0 * _DAMPING * sqrt(build_up) * lag_s)
    return (
        pole_rate * (angle_error - damped * v - build_up * lag_s * lag_s * w) - (damped - lag_s) * w
    )
