"""Commands from which every joint can still brake to rest inside its bounds.

A joint's speed v follows its command u with a lag; over a period T it covers a share
`k = 1 - exp(-T / lag)` of what is missing. So a joint that is told u_1, u_2, ... and comes to rest
has travelled

    lag v + T (u_1 + u_2 + ...)

Commands are sent, take the command latency to act, and are then held for a period, or for half of
one more where the next is late. Where whoever sends them dies, the last one is held until the
servos' own watchdog stops them. A command is safe if the commands that are still on their way,
this one for as long as it may last, and braking after it end inside the bound. Braking takes b T
from the speed in each period by commands of `v - b T / k`, their sum over T being
`((v - b T / k) (v - b T / k + b T) / (b T) + b T / 4) / 2` or a little less. Only the parts of
speeds and commands towards a bound are counted: a linear joint goes no farther.

Of a forbidden posture one angle at least is kept out: the one that is farthest from it is braked
before its face as before a limit.
"""

from collections import deque
from collections.abc import Sequence
from math import ceil
from typing import Final, NamedTuple

import numpy as np

from vergence.hardware.safety.config import ForbiddenPosture, SafetyConfig
from vergence.models.head import HeadModel
from vergence.models.joint_response import follow_joint
from vergence.models.parts import FloatArray

_MOST_RAD_S2: Final = 1e3
"""Acceleration that stands for none given. Numerical."""
_LEAST_RAD_S2: Final = 1e-3
"""Least acceleration, for heads that give 0 for a joint that is not there. Numerical."""
_BRAKING: Final = 0.5
"""Share of a joint's greatest acceleration that braking counts on: a loaded servo has less."""
_SPARE: Final = 0.7
"""Share of the greatest commanded acceleration that braking counts on: the sum above is rounded
up, so braking begins a little late. Numerical."""
_QUICK: Final = 0.25
"""Lag, by the control period, below which a joint is braked as if it had so much. Numerical."""
_EDGE_RAD: Final = 0.005
"""Distance that is kept from a limit, rad: three steps of an encoder of 4,096."""
_FACE_RAD: Final = 0.01
"""Distance that is kept from a forbidden posture: several steps of an encoder of 4,096."""
_NO_LAG_S: Final = 1e-12
"""Lag that stands for none, s. Numerical."""
HELD: Final = 1.5
"""Control periods for which a command may have to last: whoever sends the next may be late."""
_LATE: Final = 1e-9
"""Part of a period by which a latency may exceed whole periods without counting one more."""

_follow = getattr(follow_joint, "py_func", follow_joint)


class _Reach(NamedTuple):
    """How far joints go towards one side, by the command that they get next."""

    sure: FloatArray
    """(7,) way that is not to be avoided: coasting, and commands that are on their way, rad."""
    speed: FloatArray
    """(7,) speed when the next command begins to act, rad/s."""


class JointMotion:
    """The safety's model of the joints, and the commands that it allows.

    Args:
        head: the model of the head.
        lower: (7,) least angles, rad.
        upper: (7,) greatest angles, rad.
        config: bounds of the robot.
        last_s: time for which the last command may act: until the servos stop by themselves where
            nobody speaks any more, s.

    Attributes:
        speed: (7,) speeds of the model, rad/s.
        most: (7,) greatest speeds, rad/s.
        acceleration: (7,) greatest accelerations, rad/s^2.
        in_the_way: name of the forbidden posture that has limited the last command, or empty.
    """

    def __init__(
        self,
        head: HeadModel,
        lower: FloatArray,
        upper: FloatArray,
        config: SafetyConfig,
        last_s: float = 0.0,
    ) -> None:
        actuation, timing = head.actuation, head.timing
        self._period_s = timing.period_s
        self._lower, self._upper = lower + _EDGE_RAD, upper - _EDGE_RAD
        self._forbidden = config.forbidden
        self.most = np.minimum(actuation.velocity, config.speed_rad_s)
        own = np.clip(actuation.acceleration, _LEAST_RAD_S2, _MOST_RAD_S2)
        self._own_acceleration = own
        self.acceleration = np.minimum(own, config.acceleration_rad_s2)
        self._lag_s = timing.lag_s * actuation.lag_ratio
        # a joint whose lag is short against the period still takes a while to brake
        planned_s = np.maximum(self._lag_s, _QUICK * self._period_s)
        self._share = 1.0 - np.exp(-self._period_s / planned_s)
        self._late_share = 1.0 - np.exp(-HELD * self._period_s / planned_s)
        late = ceil(timing.command_latency_s / self._period_s - _LATE)
        self._lasts = max(HELD, last_s / self._period_s + late)
        self._last_share = 1.0 - np.exp(-self._lasts * self._period_s / planned_s)
        self._planned_s = planned_s
        self._true_share = -np.expm1(-self._period_s / np.maximum(self._lag_s, _NO_LAG_S))
        brake = np.minimum(_BRAKING * own, own * planned_s * self._share / self._period_s)
        self._brake = np.minimum(brake, _SPARE * self.acceleration)
        # what changes the speed by the acceleration within a period; a joint that is at its own
        # limit for all of it needs more
        self._change = np.where(
            self.acceleration < own,
            self.acceleration * self._period_s / self._true_share,
            own * (self._period_s + self._lag_s),
        )
        # a joint that is told to brake harder than its lag alone lets it goes this much farther
        harder = self._change - own * planned_s
        self._spare = np.maximum(harder, 0.0) ** 2 / (2.0 * own)
        self._spare *= 1 + late  # each command on its way may do so
        self._sent: deque[FloatArray] = deque([np.zeros(7)] * late, maxlen=late or None)
        self._late = late
        self.speed = np.zeros(7)
        self.in_the_way = ""

    def begin(self) -> None:
        """Begin anew with joints at rest."""
        self.speed = np.zeros(7)
        self._sent.extend([np.zeros(7)] * self._late)

    def took(self, command: FloatArray) -> None:
        """Let a period pass in which a command was sent, (7,) rad/s."""
        acts = command
        if self._late:
            acts = self._sent.popleft()
            self._sent.append(command)
        self.speed = np.array(
            [
                _follow(0.0, v, u, lag, a, self._period_s, left)[1]
                for v, u, lag, a, left in zip(
                    self.speed.tolist(),
                    acts.tolist(),
                    self._lag_s.tolist(),
                    self._own_acceleration.tolist(),
                    (1.0 - self._true_share).tolist(),
                    strict=True,
                )
            ]
        )

    def allowed(
        self, angles: FloatArray, measured: FloatArray, wish: FloatArray, most: FloatArray
    ) -> FloatArray:
        """The commands nearest to a wish from which the joints still brake inside their bounds.

        Args:
            angles: (7,) where the joints are, rad.
            measured: (7,) measured speeds, rad/s; the model's count too, whichever is greater.
            wish: (7,) rad/s, finite or infinite.
            most: (7,) greatest speeds at present, rad/s.

        Returns:
            (7,) rad/s.
        """
        command = self._window(np.clip(wish, -most, most))
        up, down = self._reach(measured, 1.0), self._reach(measured, -1.0)
        highest = self._greatest(self._upper - angles - up.sure, up)
        lowest = -self._greatest(angles - self._lower - down.sure, down)
        command = np.clip(command, lowest, highest)
        self.in_the_way = ""
        for posture in self._forbidden:
            kept_out = self._keep_out(posture, angles, command, up, down)
            if (kept_out != command).any():
                self.in_the_way = posture.name
            command = kept_out
        return command

    def _window(self, wish: FloatArray) -> FloatArray:
        """Wishes limited to what changes a joint's speed by its greatest acceleration."""
        speed = self.speed
        for sent in self._sent:
            speed = speed + (sent - speed) * self._true_share
        return np.asarray(np.clip(wish, speed - self._change, speed + self._change))

    def _reach(self, measured: FloatArray, side: float) -> _Reach:
        speed = np.maximum(np.maximum(side * self.speed, side * measured), 0.0)
        sure = self._planned_s * speed + self._spare
        for sent in self._sent:
            towards = np.maximum(side * sent, 0.0)
            sure = sure + HELD * self._period_s * towards
            share = np.where(towards > speed, self._late_share, self._share)
            speed = speed + (towards - speed) * share
        return _Reach(sure, speed)

    def _greatest(self, room: FloatArray, reach: _Reach) -> FloatArray:
        """The greatest command towards a side that ends within some room, 0 or more."""
        slower = self._solve(room, reach.speed, self._share)
        faster = self._solve(room, reach.speed, self._last_share)
        return np.maximum(np.where(slower <= reach.speed, slower, faster), 0.0)

    def _solve(self, room: FloatArray, speed: FloatArray, share: FloatArray) -> FloatArray:
        """The command whose way, see `_way`, is the room, by its share in the speed."""
        step = self._brake * self._period_s
        ways = room / self._period_s
        off = (1.0 - share) * speed - step / self._share + 0.5 * step
        part = self._lasts / share
        y = -part + np.sqrt(np.maximum(part**2 + 2.0 * (ways + part * off) / step, 0.0))
        return np.where(y > 0.0, (step * y - off) / share, ways / self._lasts)

    def _way(self, command: FloatArray, reach: _Reach) -> FloatArray:
        """How far joints go towards a side by a command and braking after it, rad."""
        step = self._brake * self._period_s
        # the worse of a command that acts for a period and of one that acts for long
        share = np.where(command > reach.speed, self._last_share, self._share)
        after = reach.speed + share * (command - reach.speed)
        y = np.maximum((after - step / self._share) / step + 0.5, 0.0)
        return np.asarray(reach.sure + self._period_s * (self._lasts * command + 0.5 * step * y**2))

    def _keep_out(
        self,
        posture: ForbiddenPosture,
        angles: FloatArray,
        command: FloatArray,
        up: _Reach,
        down: _Reach,
    ) -> FloatArray:
        own = list(posture.slots)
        rest = self._window(np.zeros(7))

        def span(told: FloatArray) -> tuple[FloatArray, FloatArray]:
            low = angles - self._way(np.maximum(-told, 0.0), down)
            high = angles + self._way(np.maximum(told, 0.0), up)
            return low[own], high[own]

        lower, upper = posture.lower - _FACE_RAD, posture.upper + _FACE_RAD
        low, high = span(command)
        if not ((high > lower) & (low < upper)).all():
            return command
        # of the angles that can stay out, the one that has the most room
        low, high = span(rest)
        room = np.maximum(lower - high, low - upper)
        one = int(np.argmax(room))
        slot = own[one]
        command = command.copy()
        if lower[one] - high[one] >= low[one] - upper[one]:
            left = np.full(7, lower[one]) - angles - up.sure
            command[slot] = min(command[slot], self._greatest(left, up)[slot])
        else:
            left = angles - np.full(7, upper[one]) - down.sure
            command[slot] = max(command[slot], -self._greatest(left, down)[slot])
        return command


def inside(postures: Sequence[ForbiddenPosture], angles: FloatArray) -> ForbiddenPosture | None:
    """The first forbidden posture that holds angles, (7,) rad; None if none does."""
    return next((one for one in postures if one.holds(angles)), None)
