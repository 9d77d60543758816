"""Slow, small steps of one joint, to find its direction and its zero.

Only the servo that moves gets torque, and its watchdog is armed while it moves. Directions and
zeros are not known yet, so motion is measured from the start of the step, by angles that count
beyond a turn. For the same reason a step does not stop at the joint's limits.
"""

import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import Final

import numpy as np

from vergence.envs.reading import BoolArray
from vergence.errors import HardwareError, VergenceWarning
from vergence.hardware.config import HardwareConfig
from vergence.hardware.drive import release, settle
from vergence.hardware.safety.following import FollowingMonitor
from vergence.hardware.servos import SILENT_S, JointAngles, ServoConfig, Servos

MOST_STEP_RAD: Final = 0.5
"""Largest step, rad: a person who watches the joint can still stop it in time (chosen)."""
_SPEED_FRACTION: Final = 0.1
"""Jogging speed as a fraction of the joint's greatest speed (chosen)."""
_LEAST_SPEED_RAD_S: Final = 0.024
"""Least speed of a servo's shaft that turns it, rad/s (physical: the unit of the X series)."""
_GAIN: Final = 5.0
"""Speed per remaining distance, 1/s: a tenth of what the lag of a quick servo allows (chosen)."""
_TOLERANCE_FRACTION: Final = 0.05
"""Tolerance of the end of a step, as a fraction of the step (chosen)."""
_MIN_TOLERANCE_RAD: Final = 0.003
"""Least tolerance of the end of a step, rad of the shaft: two steps of an encoder of 4,096
(chosen)."""
_STUCK_S: Final = 0.5
"""Time without progress after which a step fails, s (chosen)."""
_MAX_DEVIATION_RAD: Final = 0.02
"""Motion in the wrong direction or past the goal at which a step fails, rad (chosen)."""
_EXTRA_TIMEOUT_S: Final = 5.0
"""Time allowed for a step beyond its length divided by its speed, s (chosen)."""
_READS: Final = 4
"""Readings of a position before its servo counts as silent (chosen)."""


class Jogger:
    """Moves one joint at a time.

    Args:
        config: the robot.
        servos: its servos, open.
        clock: a monotonic clock, s.
        sleep: waits for some seconds.

    Attributes:
        servos: servos by name, with the signs and zeros found so far.
    """

    def __init__(
        self,
        config: HardwareConfig,
        servos: Servos,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.servos = {servo.name: servo for servo in config.servos}
        self._config, self._bus = config, servos
        self._clock, self._sleep = clock, sleep

    def position(self, name: str) -> float:
        """Present angle of a servo's shaft, rad."""
        place = list(self.servos).index(name)
        for _ in range(_READS):
            reading = self._bus.read()
            if np.isfinite(reading.ages_s[place]):
                return float(reading.angles[place])
        servo = self.servos[name]
        raise _failed(servo, f"an answer of the id {servo.id}", "none")

    def angle(self, name: str) -> float:
        """A joint's angle with the sign and the zero found so far, rad."""
        angles = JointAngles(
            tuple(self.servos.values()),
            self._config.head,
            reports_speed=self._bus.reports_speed,
        )
        self.position(name)
        angles.update(self._bus.read())
        return float(angles.angles[self.servos[name].slot])

    def step(self, name: str, signed_step_rad: float) -> float:
        """Turn a joint by at most `MOST_STEP_RAD`, and let it rest there; return its rotation, rad.

        One that does not follow has lost its torque, as a command of zero might not stop it.
        """
        servo, own = self.servos[name], self._own(name)
        armed = False
        try:
            for finding in self._bus.switch_on(own):
                warnings.warn(str(finding), VergenceWarning, stacklevel=2)
            armed = True
            moved = self._drive(servo, own, signed_step_rad)
            if self._rest(servo, own):
                raise _failed(servo, "rest at a velocity of zero", "a joint that turns on")
        except HardwareError as error:
            if not armed:
                self._rest(servo, own)
                raise
            if release(self._bus, own).any():
                error.args = (f"{error}; its torque is off: hold what may sink",)
            raise
        except BaseException:
            self._rest(servo, own)
            raise
        return moved

    def _own(self, name: str) -> BoolArray:
        return np.array([one == name for one in self.servos])

    def flip_sign(self, name: str) -> None:
        """Change the sign of a joint."""
        self.servos[name] = replace(self.servos[name], sign=-self.servos[name].sign)

    def set_zero(self, name: str) -> None:
        """Set a joint's zero to the present position, modulo a turn."""
        servo = self.servos[name]
        zero = (self.position(name) % (2.0 * np.pi)) / servo.unit_rad
        if servo.unit_rad != 1.0:
            zero = round(zero) % round(2.0 * np.pi / servo.unit_rad)
        self.servos[name] = replace(servo, zero=zero)

    def torque_off(self, name: str) -> None:
        """Switch a servo's torque off."""
        self._bus.release(self._own(name))

    def _rest(self, servo: ServoConfig, own: BoolArray) -> bool:
        """Stop the servo and leave it; True if it turned on, and has lost its torque."""
        moves = False
        with suppress(HardwareError):
            self._bus.stop()
            scales = np.array([one.sign / one.gear_ratio for one in self.servos.values()])
            moves = bool(settle(self._bus, scales, own, self._clock, self._sleep)[0].any())
            self._bus.leave()
        return moves

    def _drive(self, servo: ServoConfig, own: BoolArray, way_rad: float) -> float:
        head, scale = self._config.head, servo.sign / servo.gear_ratio
        least_rad_s = _LEAST_SPEED_RAD_S / servo.gear_ratio
        speed_rad_s = max(_SPEED_FRACTION * float(head.actuation.velocity[servo.slot]), least_rad_s)
        within_rad = max(_TOLERANCE_FRACTION * abs(way_rad), _MIN_TOLERANCE_RAD / servo.gear_ratio)
        start = scale * self.position(servo.name)
        begun_s = answered_s = progress_s = self._clock()
        until_s = begun_s + _EXTRA_TIMEOUT_S + abs(way_rad) / speed_rad_s
        moved = best = 0.0
        slot = np.arange(7) == servo.slot
        following = FollowingMonitor(head, head.actuation.velocity)
        place = int(np.flatnonzero(own)[0])
        while abs(left := way_rad - moved) > within_rad:
            wanted = float(np.clip(_GAIN * left, -speed_rad_s, speed_rad_s))
            wanted = float(np.copysign(max(abs(wanted), least_rad_s), wanted))
            sent = slot * scale * float(self._bus.send(np.where(own, wanted / scale, 0.0))[place])
            self._sleep(head.timing.period_s)
            now, reading = self._clock(), self._bus.read()
            if self._bus.fault:
                raise HardwareError(self._bus.fault)
            if not np.isfinite(reading.ages_s[place]):
                if now - answered_s > SILENT_S:
                    raise _failed(servo, f"an answer of the id {servo.id}", "none")
                continue
            answered_s = now
            moved = scale * float(reading.angles[place]) - start
            off = following.update(now, slot * moved, sent, sent, slot)
            along = moved * np.sign(way_rad)
            if along > best:
                best, progress_s = along, now
            expected = f"the joint to turn by {way_rad:.3f} rad"
            if along < -_MAX_DEVIATION_RAD:
                raise _failed(servo, expected, f"{moved:.3f} rad: it turns the wrong way")
            if along > abs(way_rad) + _MAX_DEVIATION_RAD:
                raise _failed(servo, expected, f"{moved:.3f} rad: it turns too far")
            if off[servo.slot] > 0.0 or now - progress_s > _STUCK_S or now > until_s:
                raise _failed(servo, expected, f"{moved:.3f} rad: it is stuck")
        return moved


def _failed(servo: ServoConfig, expected: str, got: str) -> HardwareError:
    return HardwareError(f"servos: {servo.name}: expected {expected}, got {got}")
