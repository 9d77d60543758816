"""The servos of a head on their line: opening, checks, torque, reading, commands, stopping."""

import logging
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Final

import numpy as np

from vergence.envs.reading import BoolArray
from vergence.errors import HardwareError, VergenceWarning
from vergence.hardware.checks.line import LATE_ANSWERS_CURE, open_bus
from vergence.hardware.checks.servos import check_servos, raise_errors
from vergence.hardware.config import HardwareConfig, ServoConfig
from vergence.hardware.count_log import CountLog
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.bus import SYNC_READ_BYTES
from vergence.hardware.dynamixel.repeated import ask_again, read_register, write_register
from vergence.hardware.health import HealthLevel, HealthWatch, read_health, read_limits
from vergence.hardware.resting import (
    broadcast_zero_speed,
    disable_watchdog,
    settle,
    stop_and_disable_watchdog,
)
from vergence.hardware.servo_angles import SILENT_S, ServoAngles
from vergence.hardware.servo_memory import MOTION_SPAN, describe_fault_bits
from vergence.hardware.servo_settings import ServoSettings
from vergence.models.parts import FloatArray

_LOG: Final = logging.getLogger(__name__)
_HEALTH_INTERVAL_S: Final = 1.0
"""Time between two reads of temperature, voltage and load, s (chosen)."""
_TORQUE_READ_PERIODS: Final = 10
"""Control periods between two reads of the servos' torque state (chosen)."""
_STOPPING_MISSES: Final = 3
"""Consecutive missed answers that stop the head, once `SILENT_S` has passed (chosen)."""
_PAUSE_FRACTION: Final = 0.5
"""Pause without packets after which the watchdog's state is read, as a fraction of its time. Any
packet feeds it, so it need not be read in every period (chosen)."""


_ENCODER_FAULT: Final = 1 << 3
"""Bit of HARDWARE_ERROR_STATUS: the motor's encoder fails (physical: X series)."""


class HeadServos:
    """The servos of one head in velocity mode.

    Args:
        config: the hardware configuration.
        clock: a monotonic clock, s.

    Attributes:
        angles: the servos' angles, and the conversion of velocities to ticks.
        findings: warnings of the checks, and of the registers that were changed.
        released: (7,) True for joints whose torque has been switched off.

    Raises:
        HardwareError: the line cannot be opened.
        ChecksFailedError: something is wrong with a servo; it lists all problems.
    """

    def __init__(self, config: HardwareConfig, clock: Callable[[], float]) -> None:
        self.angles = ServoAngles(config.servos, config.head)
        self._config = config
        self._clock = clock
        self._torque = False
        self.released = np.zeros(7, dtype=np.bool_)
        self._senses = 0
        said = "answers missed: %d, the last one of %s"
        self._unanswered = CountLog(_LOG, logging.WARNING, said, clock)
        self._missed: dict[int, list[float]] = {}  # times of unanswered requests by id, s
        self._stale: dict[int, int] = {}  # unmatched answers by id before these
        self._fed_s = self._pause_s = 0.0
        self._health_s = clock()
        self._warned: set[int] = set()
        self._hot: set[int] = set()
        self._bus = open_bus(config.bus)
        self._bus.names = {servo.id: servo.name for servo in config.servos}
        self._settings = ServoSettings(self._bus)
        try:
            self.findings = raise_errors(check_servos(config, self._bus))
            self._stand_still()
            for servo in config.servos:
                self._set_up(servo)
            self.findings += self._settings.findings
            self._limits = {one: read_limits(self._bus, one) for one in self.angles.ids}
            self._watches = {one: HealthWatch(limits) for one, limits in self._limits.items()}
            while not self.angles.all_reported:
                self.sense()
        except BaseException:
            try:
                self._put_back()
            finally:
                self._bus.close()
            raise

    @property
    def missed_answers(self) -> int:
        """Number of answers that did not arrive."""
        return self._bus.missed_answers

    def _stand_still(self) -> None:
        broadcast_zero_speed(self._bus, self.angles.ids)

    def _set_up(self, servo: ServoConfig) -> None:
        bus, ident = self._bus, servo.id
        if read_register(bus, ident, table.OPERATING_MODE) != table.VELOCITY_MODE:
            write_register(bus, ident, table.TORQUE_ENABLE, 0)
            write_register(bus, ident, table.OPERATING_MODE, table.VELOCITY_MODE)
            _LOG.info("%s: set to velocity mode", servo.name)
        disable_watchdog(bus, ident)
        self._settings.set_up(servo)
        self.angles.limit_ticks[ident] = read_register(bus, ident, table.VELOCITY_LIMIT)

    def _put_back(self) -> None:
        """Put back what was in the EEPROM of the servos; warn where that fails."""
        failed = [self._settings.put_back(servo) for servo in self._config.servos]
        for text in filter(None, failed):
            # `warned` marks the log line, so that a terminal does not show the warning twice
            _LOG.warning("%s", text, extra={"warned": True})
            warnings.warn(text, VergenceWarning, stacklevel=3)

    def switch_on(self) -> None:
        """Switch torque on at rest, and arm the watchdog again."""
        ids = self.angles.ids
        self._stand_still()
        self.sense()
        self._check_faults()
        for ident in ids:
            disable_watchdog(self._bus, ident)
            if not self._torque:
                write_register(self._bus, ident, table.TORQUE_ENABLE, 1)
                # a lock of the goals that a tripped watchdog has left ends with the torque
                write_register(self._bus, ident, table.GOAL_VELOCITY, 0)
        steps = max(1, round(self._config.bus.watchdog_s / table.WATCHDOG_S))
        for ident in ids:
            write_register(self._bus, ident, table.BUS_WATCHDOG, steps)
        if not self._torque:
            _LOG.info("torque on")
        _LOG.info("watchdog armed: %g s", steps * table.WATCHDOG_S)
        self._torque = True
        self.angles.rounding_error[:] = 0.0
        self._fed_s, self._pause_s = self._clock(), 0.0

    def sense(self) -> tuple[float, FloatArray, FloatArray]:
        """Read all joints; one that does not answer is extrapolated at its last speed.

        Returns:
            Time of the measurement on the clock, s; (7,) angles, rad; (7,) velocities, rad/s.

        Raises:
            HardwareError: a servo has not answered for 0.1 s, or the line is gone.
        """
        asked_s = self._clock()
        self._senses += 1
        # every other request is a byte longer: its length exposes a late answer to the one before
        address, length = MOTION_SPAN
        found = self._bus.sync_read(self.angles.ids, address, length + self._senses % 2)
        answers = {ident: data[:length] for ident, data in found.items()}
        now = self._clock()
        self._fed()
        # servos measure as the request arrives; adapters only hold their answers back
        measured_s = asked_s + self._bus.line.wire_s(SYNC_READ_BYTES + len(self.angles.ids))
        accepted = self.angles.update(answers, measured_s)
        for servo in self._config.servos:
            if servo.id in accepted:
                self._missed.pop(servo.id, None)
                continue
            if servo.id not in self._missed:
                self._stale[servo.id] = self._bus.stale[servo.id]
            missed = self._missed.setdefault(servo.id, [])
            missed.append(asked_s)
            self._unanswered.add(1, servo.name)
            # a pause without requests does not count as silence
            if now - missed[0] > SILENT_S and len(missed) >= _STOPPING_MISSES:
                # the answer to the last request may still be on its way
                late = self._bus.stale[servo.id] - self._stale[servo.id] >= len(missed) - 1
                expected = f"an answer of the id {servo.id} on {self._bus.port}"
                got, cure = "none", "check its cable and its power"
                if servo.id in answers:
                    got = "angles that no joint can have"
                elif late:
                    expected += f" within {1e3 * self._bus.cycle_timeout_s:.3g} ms"
                    got, cure = "later ones alone", LATE_ANSWERS_CURE
                if self._config.emulator_address:
                    cure = "end other programs: the emulated head shares this machine"
                raise HardwareError(
                    f"servos: {servo.name}: expected {expected}, got {got} for {SILENT_S:g} s; "
                    f"cure: {cure}"
                )
        if self._torque:
            self._check_faults()
            self._check_torque()
        return measured_s, *self.angles.joint_angles_and_speeds()

    def _check_faults(self) -> None:
        """Raise an error if a servo has a fault."""
        for servo in self._config.servos:
            if servo.id in self._bus.alerts:
                errors = 0
                with suppress(HardwareError):
                    errors = self._bus.read(servo.id, table.HARDWARE_ERROR_STATUS)
                if errors & _ENCODER_FAULT:  # its motor turns on at any goal
                    self.release_torque(np.arange(7) == servo.slot)
                raise HardwareError(
                    f"servos: {servo.name}: expected a servo without a fault, got "
                    f"{describe_fault_bits(errors) or 'one that it does not tell'}: it may have "
                    "let go; cure: hold the head, remove the cause, then switch its power off "
                    "and on"
                )

    def _check_torque(self) -> None:
        """Raise an error if a servo has lost its torque, as after a shutdown or a reboot."""
        if self._senses % _TORQUE_READ_PERIODS:
            return
        register = table.TORQUE_ENABLE
        found = self._bus.sync_read(self.angles.ids, register.address, register.length)
        for servo in self._config.servos:
            if found.get(servo.id) == b"\0" and not self.released[servo.slot]:
                raise HardwareError(
                    f"servos: {servo.name}: expected the servo with the id {servo.id} to hold its "
                    "torque, got one that has let go, as after a reboot or a loss of power; cure: "
                    "hold the head, and check the plugs of its power"
                )

    def check_health(self) -> list[str]:
        """Read temperature, voltage and load, once a second.

        Returns:
            Warnings, a line each, for servos that were well at the last read.

        Raises:
            HardwareError: a servo has to stop.
        """
        now = self._clock()
        if now - self._health_s < _HEALTH_INTERVAL_S:
            return []
        self._health_s = now
        found = read_health(self._bus, self._limits)
        said, stop = [], ""
        for servo in self._config.servos:
            if servo.id not in found:
                continue
            verdict = self._watches[servo.id].judge(found[servo.id])
            text = f"servos: {servo.name}: {verdict.text}"
            if verdict.must_release_torque:
                self._hot.add(servo.id)
            if verdict.level is HealthLevel.STOP:
                stop = stop or text
            elif verdict.level is HealthLevel.WARN and servo.id not in self._warned:
                said.append(text)
            (self._warned.discard if verdict.level is HealthLevel.OK else self._warned.add)(
                servo.id
            )
        if stop:
            raise HardwareError(stop)
        return said

    def release_torque(self, joints: BoolArray) -> None:
        """Switch the torque of some joints, (7,) True, off, as far as the line allows."""
        for servo in self._config.servos:
            if joints[servo.slot] and not self.released[servo.slot]:
                with suppress(HardwareError):
                    write_register(self._bus, servo.id, table.TORQUE_ENABLE, 0)
                    self.released[servo.slot] = True
                    _LOG.warning("%s: torque off", servo.name)

    def release_torque_if_hot(self) -> None:
        """Switch the torque of hot servos off, as holding still heats them too."""
        hot = {servo.slot for servo in self._config.servos if servo.id in self._hot}
        self.release_torque(np.isin(np.arange(7), list(hot)))

    def settle(self, sleep: Callable[[float], None]) -> BoolArray:
        """Read that the joints come to rest at zero velocity; see `vergence.hardware.resting`.

        Args:
            sleep: waits for some seconds.

        Returns:
            (7,) True for joints that did not, and have lost their torque.

        Raises:
            HardwareError: the line is gone.
        """
        return settle(self._read_angles, self.release_torque, self._clock, sleep)

    def _read_angles(self) -> FloatArray:
        """(7,) angles of joints with torque and an answer, rad; nan for the others."""
        address, length = MOTION_SPAN
        self._senses += 1
        found = self._bus.sync_read(self.angles.ids, address, length + self._senses % 2)
        self._fed()
        accepted = self.angles.update(
            {ident: data[:length] for ident, data in found.items()}, self._clock()
        )
        angles = np.full(7, np.nan)
        for servo in self._config.servos:
            if servo.id in accepted and not self.released[servo.slot]:
                angles[servo.slot] = self.angles.angles[servo.slot]
        return angles

    def send(self, velocity: FloatArray) -> FloatArray:
        """Send velocities to the servos; return the quantised ones; both (7,) rad/s."""
        ticks, sent = self.angles.velocities_to_ticks(velocity)
        self._bus.sync_write(table.GOAL_VELOCITY, ticks)
        self._fed()
        return sent

    def _fed(self) -> None:
        """Note that a packet was sent, and update the longest time without one."""
        now = self._clock()
        self._pause_s = max(self._pause_s, now - self._fed_s)
        self._fed_s = now

    @property
    def pause_s(self) -> float:
        """Longest pause between packets since the last call of `watchdog_trip_pause_s`, s."""
        return max(self._pause_s, self._clock() - self._fed_s)

    def watchdog_trip_pause_s(self) -> float:
        """Longest pause between packets since the last call if a watchdog tripped, else 0, s."""
        pause_s, self._pause_s = self.pause_s, 0.0
        if pause_s < _PAUSE_FRACTION * self._config.bus.watchdog_s:
            return 0.0
        state = [
            ask_again(partial(self._bus.read, one, table.BUS_WATCHDOG), requests=2)
            for one in self.angles.ids
        ]
        self._fed_s = self._clock()
        return pause_s if table.WATCHDOG_TRIPPED in state else 0.0

    def abandon(self) -> None:
        """Release the line, and leave the servos as they are."""
        self._bus.close()

    def close(self, sleep: Callable[[float], None] = time.sleep) -> None:
        """Stop the servos as far as the line still allows, and release it.

        Joints that do not come to rest, as `settle` reads, lose their torque.

        Args:
            sleep: waits for some seconds.
        """
        with suppress(HardwareError):
            self._stand_still()
            if self._torque:
                self.settle(sleep)
        for ident in self.angles.ids:
            with suppress(HardwareError):
                stop_and_disable_watchdog(self._bus, ident)
        try:
            self._put_back()
        finally:
            self._bus.close()
