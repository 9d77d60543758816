"""The servos of a head on their line: opened and checked, switched on, asked, driven, stopped."""

from collections.abc import Callable
from contextlib import suppress
from typing import Final

import numpy as np

from vergence.errors import HardwareError
from vergence.hardware.config import HardwareConfig, ServoConfig
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.bus import Bus
from vergence.hardware.servo_angles import SILENT_S, ServoAngles
from vergence.models.parts import FloatArray

_STATE: Final = (
    table.PRESENT_VELOCITY.address,
    table.PRESENT_VELOCITY.length + table.PRESENT_POSITION.length,
)
"""Where servos have their velocity, and their position behind it."""
_LOOKED_AT: Final = range(1, 21)
"""Ids that are asked where one does not answer, for the person who typed it."""
_TORQUE_EVERY: Final = 10
"""Periods after which servos are asked whether they still have torque."""
_PAUSE: Final = 0.5
"""Share of the watchdog's time without a packet from which on it is asked whether it has tripped:
any packet feeds it, so it need not be asked in every period."""


class HeadServos:
    """The servos of one head in velocity mode.

    Args:
        config: what the hardware is.
        clock: a steady clock, s.

    Attributes:
        angles: what is known of their angles, and what is sent for velocities.

    Raises:
        HardwareError: the line cannot be opened, or a servo does not answer, is another than
            expected, or has a fault.
    """

    def __init__(self, config: HardwareConfig, clock: Callable[[], float]) -> None:
        self.angles = ServoAngles(config.servos, config.head)
        self._config = config
        self._clock = clock
        self._torque = False
        self._senses = 0
        self._missed_s: dict[int, float] = {}  # the first question that a servo has not answered
        self._fed_s = self._pause_s = 0.0
        self._bus = Bus(config.bus.port, config.bus.baud_rate)
        try:
            for servo in config.servos:
                self._check(servo)
                self._set_up(servo)
            while not self.angles.known:
                self.sense()
        except BaseException:
            self._bus.close()
            raise

    @property
    def misses(self) -> int:
        """Answers that did not come."""
        return self._bus.misses

    def _check(self, servo: ServoConfig) -> None:
        bus, what = self._bus, f"servos: {servo.name}"
        model = bus.ping(servo.id)
        if model is None:
            there = [str(one) for one in _LOOKED_AT if bus.ping(one) is not None]
            raise HardwareError(
                f"{what}: expected a servo with the id {servo.id} on {bus.port} at "
                f"{self._config.bus.baud_rate} baud, got no answer; of the ids 1 to "
                f"{_LOOKED_AT[-1]} there are: {', '.join(there) or 'none'}"
            )
        if model not in table.MODELS:
            raise HardwareError(
                f"{what}: expected one of {', '.join(table.MODELS.values())} with the id "
                f"{servo.id}, got a servo with the model number {model}"
            )
        errors = bus.read(servo.id, table.HARDWARE_ERROR_STATUS)
        if errors:
            raise HardwareError(
                f"{what}: expected a servo without a fault, got the hardware error status "
                f"0b{errors:08b}, with which it takes no torque until it is rebooted"
            )

    def _set_up(self, servo: ServoConfig) -> None:
        bus = self._bus
        if bus.read(servo.id, table.OPERATING_MODE) != table.VELOCITY_MODE:
            bus.write(servo.id, table.TORQUE_ENABLE, 0)
            bus.write(servo.id, table.OPERATING_MODE, table.VELOCITY_MODE)
        bus.write(servo.id, table.BUS_WATCHDOG, 0)
        bus.write(servo.id, table.GOAL_VELOCITY, 0)
        self.angles.limit_ticks[servo.id] = bus.read(servo.id, table.VELOCITY_LIMIT)

    def switch_on(self) -> None:
        """Torque at rest, and the watchdog armed anew."""
        bus, ids = self._bus, self.angles.ids
        for ident in ids:
            bus.write(ident, table.BUS_WATCHDOG, 0)
            bus.write(ident, table.GOAL_VELOCITY, 0)
            if not self._torque:
                bus.write(ident, table.TORQUE_ENABLE, 1)
        steps = max(1, round(self._config.bus.watchdog_s / table.WATCHDOG_S))
        for ident in ids:
            bus.write(ident, table.BUS_WATCHDOG, steps)
        self._torque = True
        self.angles.carried[:] = 0.0
        self._fed_s, self._pause_s = self._clock(), 0.0

    def sense(self) -> tuple[float, FloatArray, FloatArray]:
        """Read all joints; one that does not answer goes on as it went.

        Returns:
            When they were measured, by the clock, s; (7,) angles, rad; (7,) velocities, rad/s.

        Raises:
            HardwareError: a servo has not answered for 0.1 s, or the line is gone.
        """
        asked_s = self._clock()
        answers = self._bus.sync_read(self.angles.ids, *_STATE)
        now = self._clock()
        self._fed()
        for servo in self._config.servos:
            if servo.id in answers:
                self._missed_s.pop(servo.id, None)
            elif now - self._missed_s.setdefault(servo.id, asked_s) > SILENT_S:
                raise HardwareError(
                    f"servos: {servo.name}: expected an answer of the id {servo.id} on "
                    f"{self._bus.port}, got none for {SILENT_S:g} s"
                )
        if self._torque:
            self._check_torque()
        # the packets left the servos about half the exchange ago
        measured_s = 0.5 * (asked_s + now)
        self.angles.take(answers, measured_s)
        return measured_s, *self.angles.joints()

    def _check_torque(self) -> None:
        """Refuse a servo with a fault, or one that has let go: after a shutdown or a reboot."""
        self._senses += 1
        limp = set(self._bus.alerts)
        if not limp and self._senses % _TORQUE_EVERY == 0:
            register = table.TORQUE_ENABLE
            found = self._bus.sync_read(self.angles.ids, register.address, register.length)
            limp = {ident for ident, data in found.items() if data == b"\0"}
        for servo in self._config.servos:
            if servo.id in limp:
                raise HardwareError(
                    f"servos: {servo.name}: expected the servo with the id {servo.id} to hold its "
                    "torque, got one that has let go, after a fault such as overload or a reboot"
                )

    def send(self, velocity: FloatArray) -> FloatArray:
        """Give the servos velocities; what was really sent, both (7,) rad/s."""
        ticks, sent = self.angles.ticks(velocity)
        self._bus.sync_write(table.GOAL_VELOCITY, ticks)
        self._fed()
        return sent

    def rest(self) -> None:
        """Let them stand still."""
        self.send(np.zeros(7))

    def _fed(self) -> None:
        """A packet has gone out: keep the longest time without one."""
        now = self._clock()
        self._pause_s = max(self._pause_s, now - self._fed_s)
        self._fed_s = now

    def paused_s(self) -> float:
        """Longest time without a packet since the last call; 0 if no watchdog has tripped."""
        pause_s = max(self._pause_s, self._clock() - self._fed_s)
        self._pause_s = 0.0
        if pause_s < _PAUSE * self._config.bus.watchdog_s:
            return 0.0
        state = [self._bus.read(one, table.BUS_WATCHDOG) for one in self.angles.ids]
        self._fed_s = self._clock()
        return pause_s if table.WATCHDOG_TRIPPED in state else 0.0

    def close(self) -> None:
        """Stop them as well as the line still allows, and give it back."""
        bus, ids = self._bus, self.angles.ids
        for _ in range(3):
            with suppress(HardwareError):
                bus.sync_write(table.GOAL_VELOCITY, dict.fromkeys(ids, 0))
        for ident in ids:
            # a servo that its watchdog has stopped takes no goal before its watchdog is off
            for register in (table.BUS_WATCHDOG, table.GOAL_VELOCITY):
                with suppress(HardwareError):
                    bus.write(ident, register, 0)
        bus.close()
