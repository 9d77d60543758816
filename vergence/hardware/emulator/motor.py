"""The motor of an emulated servo, with its velocity PI, back-EMF, friction and gravity.

With the greatest torque as an acceleration a, the velocity seen by the inner loop v_s, the goal u
and the motor's time constant T,

    dv/dt = clip(d - v / T, -a, a) - friction - g a cos(q)
    d = (e + I / T) / lag,    dI/dt = e,    e = u - v_s,    |d| <= v_0 / T

Since the PI's zero cancels the motor's pole, the response without friction and saturation is that
of `vergence.models.motion`, a lag. Friction opposes the motion by f a; a joint at rest
stays there up to `STATIC_RATIO` f a. A loop whose encoder is blind (v_s = 0) never sees its goal
reached: its integral grows, and remains at a goal of zero. With an inverted motor (-d) the loop
runs away.
"""

from math import cos
from typing import Final

STATIC_RATIO: Final = 1.6
"""Static friction per Coulomb friction (chosen: of geared servos)."""
STEP_S: Final = 5e-4
"""Integration step, s: a tenth of the shortest time constant here (numerical)."""
_NO_LOAD_RATIO: Final = 1.15
"""Speed without load, v_0, per greatest speed of the joint (chosen)."""
_STALL_RATIO: Final = 1.5
"""Torque at full duty and no speed, per greatest torque, which the current limits (chosen)."""
_MIN_TIME_CONSTANT_S: Final = 0.02
"""Least time constant of the motor, s (numerical)."""


class Motor:
    """One motor and its velocity loop.

    Args:
        lag_s: time constant of the loop, s.
        acceleration: greatest torque as an acceleration of the joint, rad/s^2; finite.
        max_speed: greatest speed of the joint, rad/s.
        friction: Coulomb friction, as a fraction of the greatest torque.
        gravity: torque of gravity at angle 0, as a fraction of the greatest torque.

    Attributes:
        integral_s: time constant of the PI's integral, s; at first the motor's, T.
    """

    def __init__(
        self,
        lag_s: float,
        acceleration: float,
        max_speed: float,
        friction: float = 0.0,
        gravity: float = 0.0,
    ) -> None:
        self.friction, self.gravity = friction, gravity
        self._lag_s, self._acceleration = lag_s, acceleration
        no_load = _NO_LOAD_RATIO * max_speed
        self._time_s = max(no_load / (_STALL_RATIO * acceleration), _MIN_TIME_CONSTANT_S)
        self._full_drive = no_load / self._time_s
        self.integral_s = self._time_s
        self._integral = 0.0

    def reset(self, v: float = 0.0) -> None:
        """Set the integral to that of a steady velocity, rad/s."""
        self._integral = self._lag_s * v * self.integral_s / self._time_s

    def step(
        self,
        q: float,
        v: float,
        goal: float | None,
        step_s: float,
        *,
        blind: bool = False,
        inverted: bool = False,
        duty: float = 1.0,
    ) -> tuple[float, float]:
        """Angle and velocity after a step, rad and rad/s.

        Args:
            q: angle, rad.
            v: velocity, rad/s.
            goal: goal velocity, rad/s; None without torque.
            step_s: the step, s, at most `STEP_S`.
            blind: True if the loop sees no motion.
            inverted: True if the motor turns against its drive.
            duty: greatest duty, a fraction.
        """
        a = self._acceleration
        if goal is None:
            self._integral, torque = 0.0, -v / self._lag_s
        else:
            error = goal if blind else goal - v
            drive = (error + self._integral / self.integral_s) / self._lag_s
            most = duty * self._full_drive
            if abs(drive) < most or drive * error < 0.0:  # no windup
                self._integral += error * step_s
            drive = min(max(drive, -most), most)
            torque = min(max((-drive if inverted else drive) - v / self._time_s, -a), a)
        torque -= self.gravity * a * cos(q)
        friction = self.friction * a
        if v == 0.0 and abs(torque) <= STATIC_RATIO * friction:
            return q, 0.0
        after, slowed = v + torque * step_s, friction * step_s
        side = 1.0 if (v or torque) > 0.0 else -1.0
        after -= side * slowed
        if v and after * v <= 0.0:  # friction holds where the joint turns round
            after = 0.0
        return q + 0.5 * (v + after) * step_s, after
