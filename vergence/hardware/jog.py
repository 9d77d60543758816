"""Slow, small steps of one joint, to find its direction and its zero.

Only the servo that moves gets torque, and its watchdog is armed while it moves. Directions and
zeros are not known yet, so motion is measured from the start of the step, in ticks that count
beyond a turn. For the same reason a step does not stop at the joint's limits.
"""

import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import Final

import numpy as np

from vergence.errors import HardwareError, VergenceWarning
from vergence.hardware.config import HardwareConfig, ServoConfig
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.bus import Bus
from vergence.hardware.dynamixel.repeated import read_register, write_register
from vergence.hardware.resting import (
    broadcast_zero_speed,
    disable_watchdog,
    settle,
    stop_and_disable_watchdog,
)
from vergence.hardware.safety.following import FollowingMonitor
from vergence.hardware.servo_angles import SILENT_S, ServoAngles
from vergence.hardware.servo_settings import ServoSettings

MOST_STEP_RAD: Final = 0.5
"""Largest step, rad: a person who watches the joint can still stop it in time (chosen)."""
_SPEED_FRACTION: Final = 0.1
"""Jogging speed as a fraction of the joint's greatest speed (chosen)."""
_GAIN: Final = 5.0
"""Speed per remaining distance, 1/s: a tenth of what the lag of a quick servo allows (chosen)."""
_TOLERANCE_FRACTION: Final = 0.05
"""Tolerance of the end of a step, as a fraction of the step (chosen)."""
_MIN_TOLERANCE_TICKS: Final = 2
"""Least tolerance of the end of a step, ticks (chosen)."""
_STUCK_S: Final = 0.5
"""Time without progress after which a step fails, s (chosen)."""
_MAX_DEVIATION_RAD: Final = 0.02
"""Motion in the wrong direction or past the goal at which a step fails, rad (chosen)."""
_EXTRA_TIMEOUT_S: Final = 5.0
"""Time allowed for a step beyond its length divided by its speed, s (chosen)."""


class Jogger:
    """Moves one joint at a time.

    Args:
        config: the robot.
        bus: its open line.
        clock: a monotonic clock, s.
        sleep: waits for some seconds.

    Attributes:
        servos: servos by name, with the signs and zeros found so far.
    """

    def __init__(
        self,
        config: HardwareConfig,
        bus: Bus,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.servos = {servo.name: servo for servo in config.servos}
        self._config, self._bus = config, bus
        self._clock, self._sleep = clock, sleep
        bus.names = {servo.id: servo.name for servo in config.servos}

    def ticks(self, name: str) -> int:
        """A servo's present position, ticks.

        Raises:
            HardwareError: it does not answer; the other methods raise it too.
        """
        return read_register(self._bus, self.servos[name].id, table.PRESENT_POSITION)

    def angle(self, name: str) -> float:
        """A joint's angle with the sign and the zero found so far, rad."""
        servo = self.servos[name]
        angles = ServoAngles((servo,), self._config.head)
        position = table.PRESENT_POSITION.encode(self.ticks(name))
        angles.update({servo.id: bytes(table.PRESENT_VELOCITY.length) + position}, self._clock())
        return float(angles.angles[servo.slot])

    def step(self, name: str, signed_step_rad: float) -> float:
        """Turn a joint by some angle and let it rest there, with torque.

        Args:
            name: the joint.
            signed_step_rad: signed step, rad, up to `MOST_STEP_RAD` in size.

        Returns:
            Measured rotation, rad.

        Raises:
            HardwareError: it does not follow, does not come to rest or does not answer. It has lost
                its torque, as far as the line allows: a command of zero might not stop it.
        """
        servo = self.servos[name]
        armed = False
        try:
            self._arm(servo)
            armed = True
            moved = self._drive(servo, signed_step_rad)
            if self._rest(servo):
                raise _failed(servo, "rest at a velocity of zero", "a joint that turns on")
        except HardwareError as error:
            if not armed:
                self._rest(servo)
                raise
            with suppress(HardwareError):
                self.torque_off(name)
                error.args = (f"{error}; its torque is off: hold what may sink",)
            raise
        except BaseException:
            self._rest(servo)
            raise
        return moved

    def flip_sign(self, name: str) -> None:
        """Change the sign of a joint."""
        self.servos[name] = replace(self.servos[name], sign=-self.servos[name].sign)

    def set_zero(self, name: str) -> None:
        """Set a joint's zero to the present position, modulo a turn."""
        zero_ticks = self.ticks(name) % table.TICKS_PER_TURN
        self.servos[name] = replace(self.servos[name], zero_ticks=zero_ticks)

    def torque_off(self, name: str) -> None:
        """Switch a servo's torque off."""
        write_register(self._bus, self.servos[name].id, table.TORQUE_ENABLE, 0)

    def _arm(self, servo: ServoConfig) -> None:
        """Set velocity mode, switch torque on at rest, and arm the watchdog."""
        bus, ident = self._bus, servo.id
        torque = read_register(bus, ident, table.TORQUE_ENABLE)
        if read_register(bus, ident, table.OPERATING_MODE) != table.VELOCITY_MODE:
            if torque:
                raise HardwareError(
                    f"servos: {servo.name}: expected velocity mode or no torque, got torque in "
                    "another mode: hold the head, and switch its power off and on"
                )
            write_register(bus, ident, table.OPERATING_MODE, table.VELOCITY_MODE)
        broadcast_zero_speed(bus, [servo.id])
        disable_watchdog(bus, ident)
        settings = ServoSettings(bus)
        settings.set_motion(servo)
        for finding in settings.findings:
            warnings.warn(str(finding), VergenceWarning, stacklevel=3)
        if not torque:
            write_register(bus, ident, table.TORQUE_ENABLE, 1)
            # a lock of the goals that a tripped watchdog has left ends with the torque
            write_register(bus, ident, table.GOAL_VELOCITY, 0)
        steps = max(1, round(self._config.bus.watchdog_s / table.WATCHDOG_S))
        write_register(bus, ident, table.BUS_WATCHDOG, steps)

    def _rest(self, servo: ServoConfig) -> bool:
        """Stop the servo, with the watchdog off, as it would trip before the next step.

        Returns:
            True if the joint turned on, and has lost its torque.
        """
        moves = False
        with suppress(HardwareError):
            broadcast_zero_speed(self._bus, [servo.id])
            moves = bool(
                settle(
                    lambda: np.array([self._angle(servo)]),
                    lambda _: self.torque_off(servo.name),
                    self._clock,
                    self._sleep,
                ).any()
            )
            stop_and_disable_watchdog(self._bus, servo.id)
        return moves

    def _drive(self, servo: ServoConfig, way_rad: float) -> float:
        timing, speed_rad_s = self._config.head.timing, self._speed(servo)
        within_rad = max(
            _TOLERANCE_FRACTION * abs(way_rad), _MIN_TOLERANCE_TICKS / abs(servo.ticks_per_rad)
        )
        tick_rad_s = servo.sign * table.TICK_RAD_S / servo.gear_ratio
        start = self.ticks(servo.name) / servo.ticks_per_rad
        begun_s = answered_s = progress_s = self._clock()
        until_s = begun_s + _EXTRA_TIMEOUT_S + abs(way_rad) / speed_rad_s
        moved = best = 0.0
        own = np.arange(7) == servo.slot
        following = FollowingMonitor(self._config.head, self._config.head.actuation.velocity)
        while abs(left := way_rad - moved) > within_rad:
            wanted = float(np.clip(_GAIN * left, -speed_rad_s, speed_rad_s))
            steps = round(wanted / tick_rad_s) or int(np.copysign(1, wanted / tick_rad_s))
            self._bus.sync_write(table.GOAL_VELOCITY, {servo.id: steps})
            self._sleep(timing.period_s)
            now = self._clock()
            if servo.id in self._bus.alerts:
                raise _failed(servo, "a servo without a fault", "one that reports a fault")
            position = self._angle(servo)
            if np.isnan(position):
                if now - answered_s > SILENT_S:
                    raise _failed(servo, f"an answer of the id {servo.id}", "none")
                continue
            answered_s = now
            moved = position - start
            sent = own * steps * tick_rad_s
            off = following.update(now, own * moved, sent, sent, own)
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

    def _angle(self, servo: ServoConfig) -> float:
        """A servo's position as an angle of its joint, rad; nan without an answer."""
        register = table.PRESENT_POSITION
        answers = self._bus.sync_read([servo.id], register.address, register.length)
        if servo.id not in answers:
            return np.nan
        return register.decode(answers[servo.id]) / servo.ticks_per_rad

    def _speed(self, servo: ServoConfig) -> float:
        """The joint's jogging speed, at least one unit of the servo's velocity, rad/s."""
        greatest = float(self._config.head.actuation.velocity[servo.slot])
        return max(_SPEED_FRACTION * greatest, table.TICK_RAD_S / servo.gear_ratio)


def _failed(servo: ServoConfig, expected: str, got: str) -> HardwareError:
    return HardwareError(f"servos: {servo.name}: expected {expected}, got {got}")
