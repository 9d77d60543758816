"""Limits of commands, such that every joint can still brake to rest inside its bounds.

A joint's speed v follows its command u with a first-order lag; in a period T it covers the fraction
`k = 1 - exp(-T / lag)` of the difference u - v. So a joint that receives the commands u_1, u_2, ...
and comes to rest has travelled

    lag v + T (u_1 + u_2 + ...)

A command acts after the command latency and is then held for a period, or half a period more if the
next one is late. If the sender dies, the last command is held until the servos' own watchdog stops
them. A command is safe if the joint stays inside the bound while it executes the commands still in
transit, this command for its longest hold, and then brakes. Braking reduces the speed by b T in
each period, with commands `v - b T / k`. Their sum is at most
`((v - b T / k) (v - b T / k + b T) / (b T) + b T / 4) / 2`. Only the parts of speeds and commands
towards a bound are counted: a linear joint goes no farther.

Of a forbidden posture at least one angle is kept outside its range: the angle with the most room
brakes before the end of its range as before a limit.

Bounds of the robot's owner are the `[safety]` section of a hardware configuration, see
docs/robot.md.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil, inf
from typing import Final

import numpy as np

from vergence.models.head import HeadModel
from vergence.models.motion import follow_joint
from vergence.models.parts import FloatArray
from vergence.models.toml_table import Rule, Table

_SECONDS: Final[Rule] = (
    lambda x: 0.05 <= x <= 60.0,
    "seconds, 0.05 to 60 (is it in milliseconds?)",
)
_RULES: Final[dict[str, Rule]] = {
    "speed_rad_s": (lambda x: 0.05 <= x <= 100.0, "rad/s, 0.05 to 100 (is it in degrees?)"),
    "acceleration_rad_s2": (
        lambda x: 0.1 <= x <= 1e4,
        "rad/s^2, 0.1 to 10000 (is it in degrees?)",
    ),
    "image_age_s": _SECONDS,
    "lost_s": _SECONDS,
    "overruns": (lambda x: 0.0 < x <= 1.0, "a share of the periods, above 0 to 1"),
}
_ANGLE_RULE: Final[Rule] = (lambda x: -10.0 <= x <= 10.0, "an angle, rad (is it in degrees?)")


@dataclass(frozen=True, kw_only=True, eq=False)
class ForbiddenPosture:
    """Postures that cause damage: those with all of the given angles inside their ranges."""

    name: str
    """Name in messages."""
    slots: tuple[int, ...]
    """Indices of its angles in the 7-element command."""
    lower: FloatArray
    """(n,) lower ends of the ranges of these angles, rad."""
    upper: FloatArray
    """(n,) upper ends, rad."""

    def contains(self, angles: FloatArray) -> bool:
        """True if a posture, (7,) rad, is forbidden; the ends of the ranges count as inside."""
        own = angles[list(self.slots)]
        return bool(((own >= self.lower) & (own <= self.upper)).all())

    def refusal(self, angles: FloatArray, names: Mapping[str, int]) -> str:
        """Error message for a forbidden posture, (7,) rad, with the slots of joints by name."""
        own = ", ".join(
            f"{name} {angles[slot]:.3f} rad" for name, slot in names.items() if slot in self.slots
        )
        return f"expected no posture of {self.name!r}, got {own}"


@dataclass(frozen=True, kw_only=True)
class SafetyConfig:
    """Bounds of a robot in addition to those of its head file."""

    speed_rad_s: float = inf
    """Greatest speed of any joint, rad/s; the head's own if that is less."""
    acceleration_rad_s2: float = inf
    """Greatest acceleration of any joint, rad/s^2; the head's own if that is less."""
    image_age_s: float = 0.5
    """Time without a new image of an eye after which the head stops, s."""
    lost_s: float = 0.5
    """Time without the target in any eye after which the head holds still, s."""
    search: bool = False
    """True if the head, after `lost_s`, searches slowly for its target instead of holding still."""
    overruns: float = 0.3
    """Greatest fraction of missed control periods in the last 2 s."""
    view_check: bool = True
    """True to compare what the images do with the configuration before the first gaze."""
    forbidden: tuple[ForbiddenPosture, ...] = ()
    """Forbidden postures; commands that lead into one are limited."""


def parse_safety(table: Table, slots: Mapping[str, int]) -> SafetyConfig:
    """Read the `[safety]` section; `slots` are indices into the 7-element command by name.

    Raises:
        HeadFileError: a key is unknown or impossible.
    """
    values: dict[str, float] = {
        name: table.number(name, rule) for name, rule in _RULES.items() if table.has(name)
    }
    search = table.boolean("search")
    view_check = not table.has("view_check") or table.boolean("view_check")
    tables = table.tables("forbidden") if table.has("forbidden") else []
    forbidden = tuple(_forbidden(one, slots) for one in tables)
    table.close()
    return SafetyConfig(search=search, view_check=view_check, forbidden=forbidden, **values)


def _forbidden(table: Table, slots: Mapping[str, int]) -> ForbiddenPosture:
    name = table.text("name", "what the posture would hurt, in words")
    ranges: dict[int, FloatArray] = {}
    for joint, slot in slots.items():
        if table.has(joint):
            ranges[slot] = ends = table.numbers(joint, (2,), _ANGLE_RULE)
            expected = "a lower and a greater angle, rad"
            table.expect(ends[0] < ends[1], joint, ends.tolist(), expected)
    table.expect(ranges, "name", name, f"a range of {', '.join(slots)} beside it")
    table.close()
    lower, upper = np.array(list(ranges.values())).T
    return ForbiddenPosture(name=name, slots=tuple(ranges), lower=lower, upper=upper)


_MAX_ACCELERATION_RAD_S2: Final = 1e3
"""Acceleration limit of joints without one, rad/s^2 (numerical)."""
_MIN_ACCELERATION_RAD_S2: Final = 1e-3
"""Least acceleration limit, rad/s^2: heads give 0 for joints that do not exist (numerical)."""
_BRAKE_RATIO: Final = 0.5
"""Braking deceleration per greatest acceleration of a joint: a loaded servo has less (chosen)."""
_BRAKE_COMMAND_RATIO: Final = 0.7
"""Braking deceleration as a fraction of the greatest commanded acceleration: the sum above is
rounded up, so braking begins a little late (numerical)."""
_MIN_LAG_PERIODS: Final = 0.25
"""Least lag that braking assumes, control periods (numerical)."""
_LIMIT_MARGIN_RAD: Final = 0.005
"""Margin to a joint limit, rad: three steps of an encoder of 4,096 (chosen)."""
_POSTURE_MARGIN_RAD: Final = 0.01
"""Margin to a forbidden posture, rad: several steps of an encoder of 4,096 (chosen)."""
_NO_LAG_S: Final = 1e-12
"""Lag in place of none, s (numerical)."""
HOLD_PERIODS: Final = 1.5
"""Control periods for which a command may be held, as the next one may be late (chosen)."""
_ROUNDING_TOLERANCE: Final = 1e-9
"""Tolerance, in control periods, for the rounding up of latencies to whole periods (numerical)."""

_follow = getattr(follow_joint, "py_func", follow_joint)


_SIDES: Final = np.array([[1.0], [-1.0]])
"""Signs of the motion up and down: arrays of shape (2, 7) are for both, each towards its side."""


class JointMotionLimiter:
    """Model of the joints, and the limits of their commands.

    `lower` and `upper` are the joints' (7,) bounds, rad. The last command may act for `last_s` if
    the sender dies, until the servos' own watchdog stops them.
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
        self._period_s = period_s = timing.period_s
        self._ends = np.stack([upper - _LIMIT_MARGIN_RAD, -(lower + _LIMIT_MARGIN_RAD)])
        self._forbidden = config.forbidden
        # (7,) greatest speeds, rad/s, and accelerations, rad/s^2
        self.max_speed = np.minimum(actuation.velocity, config.speed_rad_s)
        own = np.clip(actuation.acceleration, _MIN_ACCELERATION_RAD_S2, _MAX_ACCELERATION_RAD_S2)
        self.acceleration = np.minimum(own, config.acceleration_rad_s2)
        lag_s = timing.lag_s * actuation.lag_ratio
        # a joint with a lag much shorter than the period still takes time to brake
        self._planned_s = planned_s = np.maximum(lag_s, _MIN_LAG_PERIODS * period_s)
        late = ceil(timing.command_latency_s / period_s - _ROUNDING_TOLERANCE)
        self._longest_hold = max(HOLD_PERIODS, last_s / period_s + late)
        self._lag_fraction, self._held_lag_fraction, self._longest_lag_fraction = (
            1.0 - np.exp(-periods * period_s / planned_s)
            for periods in (1.0, HOLD_PERIODS, self._longest_hold)
        )
        self._model_lag_fraction = -np.expm1(-period_s / np.maximum(lag_s, _NO_LAG_S))
        brake = np.minimum(_BRAKE_RATIO * own, own * planned_s * self._lag_fraction / period_s)
        brake = np.minimum(brake, _BRAKE_COMMAND_RATIO * self.acceleration)
        self._brake_step = brake * period_s
        # change of the command that changes the speed at the acceleration limit for a period; a
        # joint that saturates at its own limit needs more
        self._change = np.where(
            self.acceleration < own,
            self.acceleration * period_s / self._model_lag_fraction,
            own * (period_s + lag_s),
        )
        # a joint whose braking saturates its acceleration travels this much farther, in each
        # command in transit
        harder = np.maximum(self._change - own * planned_s, 0.0)
        self._spare = harder**2 / (2.0 * own) * (1 + late)
        decay = 1.0 - self._model_lag_fraction
        self._joints = list(zip(lag_s.tolist(), own.tolist(), decay.tolist(), strict=True))
        self._sent: deque[FloatArray] = deque([np.zeros(7)] * late, maxlen=late)
        self.speed = np.zeros(7)  # of the model, rad/s
        self.limiting_posture = ""  # the forbidden one that limited the last command

    def advance(self, command: FloatArray) -> None:
        """Advance the model by a period in which a command, (7,) rad/s, was sent."""
        acts = self._sent[0] if self._sent else command
        self._sent.append(command)
        moving = zip(self.speed.tolist(), acts.tolist(), self._joints, strict=True)
        self.speed = np.array(
            [_follow(0.0, v, u, lag, a, self._period_s, k)[1] for v, u, (lag, a, k) in moving]
        )

    def limit_velocities(
        self,
        angles: FloatArray,
        measured_speeds: FloatArray,
        requested: FloatArray,
        max_speed: FloatArray,
    ) -> FloatArray:
        """Limit requested velocities, (7,) rad/s, so that the joints can brake inside their bounds.

        The greater one of measured speeds and the model's counts. Requests may be infinite.
        """
        command = self._window(np.clip(requested, -max_speed, max_speed))
        unavoidable, speed = self._coast(measured_speeds)
        towards = _SIDES * angles
        highest, lowest = self._greatest(self._ends - towards - unavoidable, speed)
        command = np.clip(command, -lowest, highest)
        self.limiting_posture = ""
        for posture in self._forbidden:
            kept_out = self._keep_out(posture, towards, command, unavoidable, speed)
            if (kept_out != command).any():
                self.limiting_posture = posture.name
            command = kept_out
        return command

    def _window(self, requested: FloatArray) -> FloatArray:
        """Limit requested velocities to the change of speed at the greatest acceleration."""
        speed = self.speed
        for sent in self._sent:
            speed = speed + (sent - speed) * self._model_lag_fraction
        return np.asarray(np.clip(requested, speed - self._change, speed + self._change))

    def _coast(self, measured: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(2, 7) unavoidable motion, rad, and speed, rad/s, when the next command begins to act."""
        speed = np.maximum(np.maximum(_SIDES * self.speed, _SIDES * measured), 0.0)
        unavoidable = self._planned_s * speed + self._spare
        for sent in self._sent:
            towards = np.maximum(_SIDES * sent, 0.0)
            unavoidable = unavoidable + HOLD_PERIODS * self._period_s * towards
            lag_fraction = np.where(towards > speed, self._held_lag_fraction, self._lag_fraction)
            speed = speed + (towards - speed) * lag_fraction
        return unavoidable, speed

    def _greatest(self, room: FloatArray, speed: FloatArray) -> FloatArray:
        """(2, 7) greatest commands, 0 or more, whose motion ends within the room, rad."""
        slower = self._solve(room, speed, self._lag_fraction)
        faster = self._solve(room, speed, self._longest_lag_fraction)
        return np.maximum(np.where(slower <= speed, slower, faster), 0.0)

    def _solve(self, room: FloatArray, speed: FloatArray, lag_fraction: FloatArray) -> FloatArray:
        """Command whose `_stopping_motion` equals the room; `lag_fraction` is k of its duration."""
        step = self._brake_step
        ways = room / self._period_s
        off = (1.0 - lag_fraction) * speed - step / self._lag_fraction + 0.5 * step
        part = self._longest_hold / lag_fraction
        y = -part + np.sqrt(np.maximum(part**2 + 2.0 * (ways + part * off) / step, 0.0))
        return np.where(y > 0.0, (step * y - off) / lag_fraction, ways / self._longest_hold)

    def _stopping_motion(self, command: FloatArray, speed: FloatArray) -> FloatArray:
        """(2, 7) motion by a command, 0 or more, and the braking after it, rad."""
        step = self._brake_step
        # the worse case: for a slower command one period, for a faster one its longest hold
        lag_fraction = np.where(command > speed, self._longest_lag_fraction, self._lag_fraction)
        after = speed + lag_fraction * (command - speed)
        y = np.maximum((after - step / self._lag_fraction) / step + 0.5, 0.0)
        return np.asarray(self._period_s * (self._longest_hold * command + 0.5 * step * y**2))

    def _keep_out(
        self,
        posture: ForbiddenPosture,
        towards: FloatArray,
        command: FloatArray,
        unavoidable: FloatArray,
        speed: FloatArray,
    ) -> FloatArray:
        own = list(posture.slots)
        begins = np.stack(
            [posture.lower - _POSTURE_MARGIN_RAD, -posture.upper - _POSTURE_MARGIN_RAD]
        )

        def room(velocity: FloatArray) -> FloatArray:
            motion = self._stopping_motion(np.maximum(_SIDES * velocity, 0.0), speed)
            return begins - (towards + (unavoidable + motion))[:, own]

        if (room(command) >= 0.0).any():
            return command
        # the angle with the most room is kept out, on the side where it has it
        left = room(self._window(np.zeros(7)))
        one = int(np.argmax(left.max(axis=0)))
        side, slot = int(np.argmax(left[:, one])), own[one]
        most = self._greatest(begins[:, [one]] - towards - unavoidable, speed)[side, slot]
        command = command.copy()
        command[slot] = _SIDES[side, 0] * min(_SIDES[side, 0] * command[slot], most)
        return command


def find_containing_posture(
    postures: Sequence[ForbiddenPosture], angles: FloatArray
) -> ForbiddenPosture | None:
    """First forbidden posture that contains the angles, (7,) rad; None if there is none."""
    return next((one for one in postures if one.contains(angles)), None)
