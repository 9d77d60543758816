"""The seam between a head and its servos: what a bus does, and the angles of joints behind it.

A bus speaks of its own servos alone: of their shafts, in rad and rad/s, in the order of
`[[servos]]` in the configuration. Signs, gears, zeros, limits, supervision and logs lie above it;
registers, units and bytes below. `vergence.hardware.dynamixel.servos` is the bus that comes with
the package; `kind = "module:class"` in `[bus]` names another, see docs/examples/own_bus.py.
"""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, Final, NamedTuple

import numpy as np

from vergence.entry_points import user_error_with_place
from vergence.envs.reading import BoolArray
from vergence.errors import ConfigurationError, Finding, HardwareError
from vergence.models.head import HeadModel
from vergence.models.parts import EYES, NECK, FloatArray

SILENT_S: Final = 0.1
"""Time without an answer after which a servo counts as lost, s (chosen)."""
_MAX_SPEED_RATIO: Final = 2.0
"""Greatest accepted speed as a ratio to the head's greatest (chosen)."""
_EXTRA_MOTION_RAD: Final = 0.1
"""Accepted motion beyond that of this speed, rad, for a servo that is pushed (chosen)."""
_MAX_TIME_ERROR_S: Final = 1.0
"""Greatest difference of a reading's time to the present, s: it is of another clock (chosen)."""
_SPEED_FILTER_S: Final = 0.02
"""Time constant of the speeds of servos that report none, s (chosen: a period at 60 Hz)."""


@dataclass(frozen=True, kw_only=True)
class ServoConfig:
    """One servo and its coupling to the neck joint or eye actuator that it moves."""

    name: str
    """Name of the neck joint or eye actuator."""
    slot: int
    """Index into the 7-element command, see `vergence.envs.plant.Plant.step`."""
    id: int
    """Id on the bus."""
    zero: float
    """Position of the shaft at the joint's zero angle, in units of `unit_rad`."""
    sign: int
    """1, or -1 if the servo turns against the joint."""
    gear_ratio: float
    """Turns of the servo per turn of the joint."""
    lower_rad: float
    """Least angle of the joint, rad."""
    upper_rad: float
    """Greatest angle of the joint, rad."""
    unit_rad: float = 1.0
    """Unit of positions in the configuration and in messages, rad: of a bus that counts, its
    step."""

    @property
    def zero_key(self) -> str:
        """Name of `zero` in the configuration."""
        return "zero_rad" if self.unit_rad == 1.0 else "zero_ticks"

    def position_text(self, shaft_rad: float) -> str:
        """A position of the shaft as the configuration states positions."""
        if self.unit_rad == 1.0:
            return f"{shaft_rad:.3f} rad"
        return str(round(shaft_rad / self.unit_rad))


class ServoReading(NamedTuple):
    """The servos of a bus at one time, in the order in which it was made with them."""

    time_s: float
    """Time of the reading on the bus's clock, s."""
    angles: FloatArray
    """(n,) angles of the shafts, rad."""
    speeds: FloatArray
    """(n,) their speeds, rad/s; anything if the bus reports none."""
    ages_s: FloatArray
    """(n,) time from the measurement to `time_s`, s; inf for a servo without an answer."""


class Servos(ABC):
    """The servos of a head on their bus, which take speeds; the interface of a bus.

    All arrays are (n,), in the order of `servos`. One thread at a time calls, and waits: `read` and
    `send` together should take less than half a control period. A servo that does not answer is no
    error (`ServoReading.ages_s`). Anything raised, best a `vergence.errors.HardwareError` with the
    cure, stops the head: it comes to rest as far as the bus allows.

    Args:
        servos: the servos.
        head: the model of the head.
        clock: a monotonic clock, s.
        **options: the other keys of `[bus]`, for a bus of somebody's own.
    """

    unit_rad: ClassVar[float] = 1.0
    """See `ServoConfig.unit_rad`."""
    port: str = ""
    """Name of the line in messages."""
    stops_alone_after_s: float | None = None
    """Time without a word after which a servo stops by itself, s; None if nothing stops it."""
    reports_speed: bool = True
    """False if speeds have to be computed from angles."""
    fault: str = ""
    """What the servos tell in `read` to be wrong with them, in words, until `open` clears it; the
    head stops at once."""
    must_let_go: BoolArray = np.zeros((), dtype=np.bool_)
    """Servos that have to lose their torque: with a `fault` at once, else as soon as they rest, as
    hot ones do."""
    missed_answers: int = 0
    """Number of answers so far that did not arrive."""

    def __init__(
        self,
        servos: Sequence[ServoConfig],
        head: HeadModel,
        clock: Callable[[], float] = time.monotonic,
        **options: Any,
    ) -> None:
        self.servos, self.head, self.clock = tuple(servos), head, clock

    @abstractmethod
    def open(self) -> None:
        """Open the line; nothing is written to a servo. A closed bus may be opened again."""

    def check(self) -> list[Finding]:
        """Find what is wrong, without moving anything.

        Called before servos have torque, and then once a second, where it may take some ms.

        Returns:
            Errors, which stop the head or refuse to move it, and warnings; the part of one servo is
            `servos: NAME`.
        """
        return []

    def describe(self) -> dict[str, str]:
        """What is known of the bus (`bus`) and of each servo (`servos: NAME`), in words."""
        return {"bus": type(self).__name__}

    @abstractmethod
    def switch_on(self, which: BoolArray) -> list[Finding]:
        """Give servos torque at rest, ready for speeds; those that have it keep it.

        Returns:
            Warnings of what had to be changed for it.
        """

    @abstractmethod
    def read(self) -> ServoReading:
        """Read all servos."""

    @abstractmethod
    def send(self, speeds: FloatArray) -> FloatArray:
        """Send speeds of the shafts, rad/s, to servos with torque; return what they got.

        A bus whose servos round speeds off should add what it rounded off to the next ones.
        """

    @abstractmethod
    def stop(self) -> None:
        """Send zero to all servos at once."""

    @abstractmethod
    def release(self, which: BoolArray) -> None:
        """Take the torque of some servos."""

    def leave(self) -> None:
        """Leave servos at rest, to which nobody speaks from now on; they keep their torque."""
        self.stop()

    def stopped_alone(self, pause_s: float) -> bool:
        """True if servos have stopped by themselves in a pause of some seconds."""
        return self.stops_alone_after_s is not None and pause_s > self.stops_alone_after_s

    @abstractmethod
    def close(self) -> None:
        """Release the line; called once after each `open`, also one that has failed."""


def guard(servos: Servos) -> Servos:
    """Have a bus of somebody's own say what is wrong with it in one line, as a `HardwareError`.

    Raises:
        ConfigurationError: it is made wrongly.
    """
    count = len(servos.servos)
    alone_s: Any = servos.stops_alone_after_s
    if not (alone_s is None or (isinstance(alone_s, int | float) and alone_s > 0.0)):
        raise ConfigurationError(
            f"bus: expected seconds or None in stops_alone_after_s, got {alone_s!r:.60}"
        )

    def array(name: str, value: Any) -> FloatArray:
        found = np.asarray(value, dtype=np.float64)
        if found.shape != (count,):
            raise HardwareError(
                f"bus: expected arrays of {count} servos from {name}, got the shape {found.shape}"
            )
        return found

    def judged(name: str, found: Any) -> Any:
        expected = {"read": "a ServoReading", "send": "finite speeds"}.get(
            name, "a list of Finding"
        )
        wrong = HardwareError(f"bus: expected {expected} from {name}, got {found!r:.60}")
        if name == "read":
            if not isinstance(found, tuple) or len(found) != len(ServoReading._fields):
                raise wrong
            now_s, time_s = servos.clock(), float(found[0])
            if not abs(now_s - time_s) < _MAX_TIME_ERROR_S:
                raise HardwareError(
                    f"bus: expected a time of the clock that the bus is made with, {now_s:.3f} s, "
                    f"from read, got {time_s:.3f} s"
                )
            if np.shape(servos.must_let_go) not in ((), (count,)):
                raise HardwareError(f"bus: expected must_let_go of {count} servos")
            reading = ServoReading(time_s, *(array(name, one) for one in found[1:]))
            if (reading.ages_s < 0.0).any():
                raise HardwareError(f"bus: expected ages of 0 s or more, got {reading.ages_s}")
            return reading
        if name == "send":
            sent = array(name, found)
            if not np.isfinite(sent).all():
                raise wrong
            return sent
        if name in ("check", "switch_on"):
            findings = [] if found is None else list(found)
            if not all(isinstance(one, Finding) for one in findings):
                raise wrong
            return findings
        if name == "describe":
            return {str(part): str(text) for part, text in (found or {}).items()}
        return found

    def guarded(name: str, method: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return judged(name, method(*arguments))
        except HardwareError:
            raise
        except Exception as error:
            raise HardwareError(f"bus: {name}: {user_error_with_place(error)}") from error

    for name in (
        *("open", "check", "describe", "switch_on", "read", "send", "stop", "release"),
        *("leave", "stopped_alone", "close"),
    ):
        setattr(servos, name, partial(guarded, name, getattr(servos, name)))
    return servos


class JointAngles:
    """Angles of a head's actuators behind the readings of its servos.

    A reading is accepted only if the joint can have moved so far since the last one, and can turn
    so fast: one damaged packet in 65,536 still has a matching checksum.

    Args:
        servos: the servos.
        head: the model of the head.
        reports_speed: see `Servos.reports_speed`.

    Attributes:
        angles: (7,) estimated angles of the neck's joints and the actuators of the eyes, rad.
        speeds: (7,) their speeds, rad/s.
        has_servo: (7,) True for slots with a servo.
        slots: (n,) slot of each servo.
        lower: (7,) least angles, rad.
        upper: (7,) greatest angles, rad.
    """

    def __init__(
        self, servos: Sequence[ServoConfig], head: HeadModel, *, reports_speed: bool = True
    ) -> None:
        self._head, self._reports_speed = head, reports_speed
        self.slots = np.array([servo.slot for servo in servos], dtype=np.intp)
        self._scale = np.array([servo.sign / servo.gear_ratio for servo in servos])
        self._zero_rad = np.array([servo.zero * servo.unit_rad for servo in servos])
        lower, upper = (
            np.array([getattr(servo, name) for servo in servos])
            for name in ("lower_rad", "upper_rad")
        )
        self._middle, self._turn = 0.5 * (lower + upper), 2.0 * np.pi * np.abs(self._scale)
        self.angles, self.speeds = np.zeros(7), np.zeros(7)
        self.lower, self.upper = self.by_slot(lower), self.by_slot(upper)
        self.has_servo = np.isin(np.arange(7), self.slots)
        self._estimated_s = self._accepted_s = np.full(len(servos), np.nan)
        self._accepted = np.zeros(len(servos))
        self._fastest = _MAX_SPEED_RATIO * head.actuation.velocity[self.slots]

    def by_slot(self, values: FloatArray) -> FloatArray:
        """(7,) values of which each servo's is given, (n,); 0 in slots without one."""
        out = np.zeros(7, dtype=values.dtype)
        out[self.slots] = values
        return out

    def of_servos(self, values: FloatArray) -> FloatArray:
        """(n,) values of the servos, from (7,) by slot."""
        return np.asarray(values[self.slots])

    def ages_s(self, now_s: float) -> FloatArray:
        """(7,) time since the last accepted answer of each servo, s; 0 in slots without one."""
        return self.by_slot(now_s - self._accepted_s)

    @property
    def all_reported(self) -> bool:
        """True if each servo has reported its angle."""
        return not np.isnan(self._accepted_s).any()

    def update(self, reading: ServoReading) -> BoolArray:
        """Update angles and speeds; a joint without an answer continues at its speed.

        Returns:
            (n,) True for the servos whose answers are accepted.
        """
        old, speeds = self.of_servos(self.angles), self.of_servos(self.speeds)
        answered = np.isfinite(reading.ages_s) & np.isfinite(reading.angles)
        age_s = np.where(answered, reading.ages_s, 0.0)
        # the equivalent angle nearest to the middle of the joint's range
        found = (reading.angles - self._zero_rad) * self._scale
        found = found - self._turn * np.rint((found - self._middle) / self._turn)
        since_s = reading.time_s - age_s - self._accepted_s  # nan before the first answer
        told = reading.speeds * self._scale if self._reports_speed else np.zeros_like(found)
        first = np.isnan(since_s)
        possible = np.abs(told) <= self._fastest + 1.0
        possible &= np.abs(found - old) <= _EXTRA_MOTION_RAD + self._fastest * since_s
        accepted = answered & (first | possible)
        if not self._reports_speed:
            weight = np.where(first, 0.0, since_s / (since_s + _SPEED_FILTER_S))
            slope = (found - self._accepted) / np.where(since_s > 0.0, since_s, np.inf)
            told = speeds + weight * (slope - speeds)
        # after a longer silence the caller stops the head, or no read took place
        ahead_s = np.minimum(reading.time_s - self._estimated_s, SILENT_S)
        ahead = old + speeds * np.nan_to_num(ahead_s)
        self.angles = self.by_slot(np.where(accepted, found + told * age_s, ahead))
        self.speeds = self.by_slot(np.where(accepted, told, speeds))
        self._accepted = np.where(accepted, found, self._accepted)
        self._accepted_s = np.where(accepted, reading.time_s - age_s, self._accepted_s)
        self._estimated_s = np.full(len(found), reading.time_s)
        return np.asarray(accepted)

    def joint_angles_and_speeds(self) -> tuple[FloatArray, FloatArray]:
        """(7,) angles and (7,) speeds of the joints, rad and rad/s."""
        actuation = self._head.actuation
        q, v = actuation.joints_of(self.angles), self.speeds.copy()
        if not actuation.direct:
            v[EYES] = actuation.to_joints @ self.speeds[EYES]
        rest = self._head.rest()
        q[NECK] = np.where(self.has_servo[NECK], q[NECK], rest[NECK])
        return q, v

    def shaft_speeds(self, velocity: FloatArray) -> FloatArray:
        """(n,) speeds of the shafts, rad/s, for (7,) velocities of the actuators, rad/s."""
        return np.asarray(self.of_servos(velocity) / self._scale)

    def velocities(self, shaft_speeds: FloatArray) -> FloatArray:
        """(7,) velocities of the actuators, rad/s, of (n,) speeds of the shafts, rad/s."""
        return self.by_slot(shaft_speeds * self._scale)
