"""The servos of a head on their line: opened and checked, switched on, asked, driven, stopped."""

import logging
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Final, TypeVar

from vergence.errors import HardwareError
from vergence.hardware.checks.line import open_bus
from vergence.hardware.checks.servos import check_servos, refuse_errors
from vergence.hardware.config import HardwareConfig, ServoConfig
from vergence.hardware.count_log import CountLog
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.health import HealthWatch, Level, read_health, read_limits
from vergence.hardware.resting import let_rest, stand_still
from vergence.hardware.servo_angles import SILENT_S, ServoAngles
from vergence.hardware.servo_memory import fault_words
from vergence.models.parts import FloatArray

_LOG: Final = logging.getLogger(__name__)
_T = TypeVar("_T")
_STATE: Final = (
    table.PRESENT_VELOCITY.address,
    table.PRESENT_VELOCITY.length + table.PRESENT_POSITION.length,
)
"""Where servos have their velocity, and their position behind it."""
_HEALTH_S: Final = 1.0
"""Time between two looks at temperature, voltage and load, s."""
_TORQUE_EVERY: Final = 10
"""Periods after which servos are asked whether they still have torque."""
_MISSES: Final = 3
"""Questions without an answer that are silence, if they took long enough."""
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
        findings: warnings of the checks.

    Raises:
        HardwareError: the line cannot be opened.
        ChecksFailedError: something is wrong with a servo; all that is wrong is listed.
    """

    def __init__(self, config: HardwareConfig, clock: Callable[[], float]) -> None:
        self.angles = ServoAngles(config.servos, config.head)
        self._config = config
        self._clock = clock
        self._torque = False
        self._senses = 0
        said = "answers missed: %d, the last one of %s"
        self._unanswered = CountLog(_LOG, logging.WARNING, said, clock)
        self._missed: dict[int, list[float]] = {}  # when who has not answered since was asked, s
        self._fed_s = self._pause_s = 0.0
        self._health_s = clock()
        self._warned: set[int] = set()
        self._hot: set[int] = set()
        self._bus = open_bus(config.bus)
        try:
            self.findings = refuse_errors(check_servos(config, self._bus))
            self._stand_still()
            for servo in config.servos:
                self._set_up(servo)
            self._limits = {one: read_limits(self._bus, one) for one in self.angles.ids}
            self._watches = {one: HealthWatch(limits) for one, limits in self._limits.items()}
            while not self.angles.known:
                self.sense()
        except BaseException:
            self._bus.close()
            raise

    @property
    def misses(self) -> int:
        """Answers that did not come."""
        return self._bus.misses

    def _stand_still(self) -> None:
        stand_still(self._bus, self.angles.ids)

    def _set_up(self, servo: ServoConfig) -> None:
        bus = self._bus
        if bus.read(servo.id, table.OPERATING_MODE) != table.VELOCITY_MODE:
            bus.write(servo.id, table.TORQUE_ENABLE, 0)
            bus.write(servo.id, table.OPERATING_MODE, table.VELOCITY_MODE)
            _LOG.info("%s: set to velocity mode", servo.name)
        bus.write(servo.id, table.BUS_WATCHDOG, 0)
        bus.write(servo.id, table.GOAL_VELOCITY, 0)
        self.angles.limit_ticks[servo.id] = bus.read(servo.id, table.VELOCITY_LIMIT)

    def switch_on(self) -> None:
        """Torque at rest, and the watchdog armed anew."""
        ids = self.angles.ids
        self._stand_still()
        self.sense()
        self._check_faults()
        for ident in ids:
            self._write(ident, table.BUS_WATCHDOG, 0)
            self._write(ident, table.GOAL_VELOCITY, 0)
            if not self._torque:
                self._write(ident, table.TORQUE_ENABLE, 1)
        steps = max(1, round(self._config.bus.watchdog_s / table.WATCHDOG_S))
        for ident in ids:
            self._write(ident, table.BUS_WATCHDOG, steps)
        if not self._torque:
            _LOG.info("torque on")
        _LOG.info("watchdog armed: %g s", steps * table.WATCHDOG_S)
        self._torque = True
        self.angles.carried[:] = 0.0
        self._fed_s, self._pause_s = self._clock(), 0.0

    def _write(self, ident: int, register: table.Register, value: int) -> None:
        """Write a register, again if the first answer is lost."""
        self._twice(ident, partial(self._bus.write, ident, register, value))

    def _twice(self, ident: int, ask: Callable[[], _T]) -> _T:
        """Ask a servo, again if the first answer is lost."""
        with suppress(HardwareError):
            return ask()
        try:
            return ask()
        except HardwareError as error:
            name = next(servo.name for servo in self._config.servos if servo.id == ident)
            raise HardwareError(f"servos: {name}: {error}") from None

    def sense(self) -> tuple[float, FloatArray, FloatArray]:
        """Read all joints; one that does not answer goes on as it went.

        Returns:
            When they were measured, by the clock, s; (7,) angles, rad; (7,) velocities, rad/s.

        Raises:
            HardwareError: a servo has not answered for 0.1 s, or the line is gone.
        """
        asked_s = self._clock()
        self._senses += 1
        # every other question asks for a byte more: a late answer to the one before is told by it
        address, length = _STATE
        found = self._bus.sync_read(self.angles.ids, address, length + self._senses % 2)
        answers = {ident: data[:length] for ident, data in found.items()}
        now = self._clock()
        self._fed()
        # the packets left the servos about half the exchange ago
        measured_s = 0.5 * (asked_s + now)
        believed = self.angles.take(answers, measured_s)
        for servo in self._config.servos:
            if servo.id in believed:
                self._missed.pop(servo.id, None)
                continue
            missed = self._missed.setdefault(servo.id, [])
            missed.append(asked_s)
            self._unanswered.add(1, servo.name)
            # a pause in which nobody asked is no silence
            if now - missed[0] > SILENT_S and len(missed) >= _MISSES:
                got = "angles that no joint can have" if servo.id in answers else "none"
                raise HardwareError(
                    f"servos: {servo.name}: expected an answer of the id {servo.id} on "
                    f"{self._bus.port}, got {got} for {SILENT_S:g} s; cure: check its cable and "
                    "its power"
                )
        if self._torque:
            self._check_faults()
            self._check_torque()
        return measured_s, *self.angles.joints()

    def _check_faults(self) -> None:
        """Refuse a servo with a fault."""
        for servo in self._config.servos:
            if servo.id in self._bus.alerts:
                errors = 0
                with suppress(HardwareError):
                    errors = self._bus.read(servo.id, table.HARDWARE_ERROR_STATUS)
                raise HardwareError(
                    f"servos: {servo.name}: expected a servo without a fault, got "
                    f"{fault_words(errors) or 'one that it does not tell'}: it may have let go; "
                    "cure: hold the head, remove the cause, then switch its power off and on"
                )

    def _check_torque(self) -> None:
        """Refuse a servo that has let go, as after a shutdown or a reboot."""
        if self._senses % _TORQUE_EVERY:
            return
        register = table.TORQUE_ENABLE
        found = self._bus.sync_read(self.angles.ids, register.address, register.length)
        for servo in self._config.servos:
            if found.get(servo.id) == b"\0":
                raise HardwareError(
                    f"servos: {servo.name}: expected the servo with the id {servo.id} to hold its "
                    "torque, got one that has let go, as after a reboot or a loss of power; cure: "
                    "hold the head, and check the plugs of its power"
                )

    def check_health(self) -> list[str]:
        """Look at temperature, voltage and load, once a second.

        Returns:
            Warnings, a line each, of servos that were well at the last look.

        Raises:
            HardwareError: a servo has to stop.
        """
        now = self._clock()
        if now - self._health_s < _HEALTH_S:
            return []
        self._health_s = now
        found = read_health(self._bus, self._limits)
        said, stop = [], ""
        for servo in self._config.servos:
            if servo.id not in found:
                continue
            verdict = self._watches[servo.id].take(found[servo.id])
            text = f"servos: {servo.name}: {verdict.text}"
            if verdict.hot:
                self._hot.add(servo.id)
            if verdict.level is Level.STOP:
                stop = stop or text
            elif verdict.level is Level.WARN and servo.id not in self._warned:
                said.append(text)
            (self._warned.discard if verdict.level is Level.OK else self._warned.add)(servo.id)
        if stop:
            raise HardwareError(stop)
        return said

    def let_go_if_hot(self) -> None:
        """Take the torque from servos that are hot: holding still heats them too."""
        for ident in self._hot:
            with suppress(HardwareError):
                self._bus.write(ident, table.TORQUE_ENABLE, 0)

    def send(self, velocity: FloatArray) -> FloatArray:
        """Give the servos velocities; what was really sent, both (7,) rad/s."""
        ticks, sent = self.angles.ticks(velocity)
        self._bus.sync_write(table.GOAL_VELOCITY, ticks)
        self._fed()
        return sent

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
        state = [
            self._twice(one, partial(self._bus.read, one, table.BUS_WATCHDOG))
            for one in self.angles.ids
        ]
        self._fed_s = self._clock()
        return pause_s if table.WATCHDOG_TRIPPED in state else 0.0

    def abandon(self) -> None:
        """Give the line back, and leave the servos as they are."""
        self._bus.close()

    def close(self) -> None:
        """Stop them as well as the line still allows, and give it back."""
        with suppress(HardwareError):
            self._stand_still()
        for ident in self.angles.ids:
            with suppress(HardwareError):
                let_rest(self._bus, ident)
        self._bus.close()
