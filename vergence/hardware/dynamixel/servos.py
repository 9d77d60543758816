"""Dynamixel servos in velocity mode: `kind = "dynamixel"` in `[bus]`.

Some registers shape motion or protect the servo; they are set for a run. Profiles shape a commanded
velocity before the servo follows it, and a limit of the PWM takes its torque. A servo switches its
torque off only at those faults that SHUTDOWN lists, which from the factory does not have a broken
encoder: its motor runs away. Registers of the RAM keep the new value until the power goes off;
those of the EEPROM are put back at the end. They are locked while torque is on, so a servo that
holds torque lets go for a moment, and only at rest.

The rounding error of speeds, in units of 0.229 rev/min, is carried over to the next period.
"""

import logging
import os
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Final

import numpy as np

from vergence.envs.reading import BoolArray
from vergence.errors import Finding, HardwareError, ServoRefusalError, VergenceWarning
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.bus import SYNC_READ_BYTES, Bus
from vergence.hardware.dynamixel.checks import (
    LATE_ANSWERS_CURE,
    HealthWatch,
    Level,
    check_servos,
    open_bus,
    read_health,
    read_limits,
)
from vergence.hardware.dynamixel.control_table import (
    MOTION_SPAN,
    Register,
    describe_fault_bits,
    model_name,
)
from vergence.hardware.servos import SILENT_S, ServoConfig, ServoReading, Servos
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

_LOG: Final = logging.getLogger(__name__)
_TORQUE_READ_PERIODS: Final = 6
"""Control periods between two reads of the servos' torque state (chosen: at 60 Hz sooner than a
joint without torque is seen not to follow)."""
_STOPPING_MISSES: Final = 3
"""Consecutive missed answers that stop the head, once `SILENT_S` has passed (chosen)."""
_ZERO_REPEATS: Final = 3
"""Number of times that zero velocity is sent, as servos do not confirm a broadcast (chosen)."""
_ZERO_COMMAND_TICKS: Final = 0.05
"""Commands below this count as zero, ticks: the carry-over is dropped, the joint rests (chosen)."""
_ENCODER_FAULT: Final = 1 << 3
"""Bit of HARDWARE_ERROR_STATUS: the motor's encoder fails (physical: X series)."""
_NEEDED_SHUTDOWN: Final = 1 << 3 | 1 << 5
"""Bits that SHUTDOWN needs: motor encoder and overload (physical: Dynamixel X series)."""
_REST_READS: Final = 500
"""Reads of the speed before a joint counts as one that does not come to rest; they take half a
second at least (chosen)."""
_REST_TICKS: Final = 1
"""Greatest speed at rest, units of PRESENT_VELOCITY: its resolution (chosen)."""


class DynamixelServos(Servos):
    """The servos of one head on one serial line; see `Servos`.

    Args:
        servos: the servos.
        head: the model of the head.
        clock: a monotonic clock, s.
        port: device file of the line.
        baud_rate: its baud rate, bit/s.
        watchdog_s: time without a packet after which the servos stop by themselves, s.
    """

    unit_rad = table.TICK_RAD
    models = tuple(table.MODELS.values())

    def __init__(
        self,
        servos: Sequence[ServoConfig],
        head: HeadModel,
        clock: Callable[[], float] = time.monotonic,
        *,
        port: str,
        baud_rate: int = 1_000_000,
        watchdog_s: float = 0.2,
    ) -> None:
        super().__init__(servos, head, clock)
        self.port, self._baud_rate = port, baud_rate
        self._watchdog_steps = max(1, round(watchdog_s / table.WATCHDOG_S))
        self.stops_alone_after_s = watchdog_s + table.WATCHDOG_S  # it counts in these steps
        self.ids = [servo.id for servo in self.servos]
        self._line: Bus | None = None
        self._reset()

    def _reset(self) -> None:
        count = len(self.servos)
        self.fault, self.must_let_go = "", np.zeros(count, dtype=np.bool_)
        self._torque = np.zeros(count, dtype=np.bool_)
        self._watches: dict[int, HealthWatch] = {}
        self._ready: list[int] = []  # ids of the servos that have been set up
        self._checked = False
        self._limit_ticks = np.zeros(count)
        self._rounding_error = np.zeros(count)
        self._reads = self._sends = 0
        self._missed: dict[int, list[float]] = {}  # times of unanswered requests by id, s
        self._stale: dict[int, int] = {}  # unmatched answers by id before these
        self._changed: dict[str, list[str]] = {}  # names of servos by what was changed
        self._kept: dict[int, dict[Register, int]] = {}  # first values in the EEPROM by id

    @property
    def _bus(self) -> Bus:
        if self._line is None:
            raise HardwareError(f"{self.port}: expected an open serial line, got a closed one")
        return self._line

    @property
    def missed_answers(self) -> int:  # type: ignore[override]
        """Number of answers so far that did not arrive."""
        return 0 if self._line is None else self._line.missed_answers

    def open(self) -> None:
        """See `Servos.open`.

        Raises:
            ChecksFailedError: the port cannot be opened.
        """
        self._reset()
        self._pid = os.getpid()
        self._line = open_bus(self.port, self._baud_rate)
        self._line.names = {servo.id: servo.name for servo in self.servos}

    def check(self) -> list[Finding]:
        """All problems of servos and line; from the second time on, those of their health."""
        if not self._checked and not self._torque.any():
            self._checked = True
            problems = check_servos(self.servos, self.head, self._bus)
            for ident in self.ids:
                with suppress(HardwareError):  # one that is missing
                    self._watches[ident] = HealthWatch(read_limits(self._bus, ident))
            return problems
        found = read_health(self._bus, {one: watch.limits for one, watch in self._watches.items()})
        findings = []
        for place, servo in enumerate(self.servos):
            if servo.id not in found:
                continue
            verdict = self._watches[servo.id].judge(found[servo.id])
            self.must_let_go[place] |= verdict.is_hot
            if verdict.level:
                warns = verdict.level == Level.WARN
                part = f"servos: {servo.name}"
                findings.append(Finding(part=part, problem=verdict.text, warning=warns))
        return findings

    def describe(self) -> dict[str, str]:
        """See `Servos.describe`."""
        out = {"bus": f"{self.port} at {self._baud_rate} baud"}
        for servo in self.servos if self._line is not None else ():
            with suppress(HardwareError):
                get = self._bus.read_memory(servo.id).get
                volts, celsius = (
                    0.1 * get(table.PRESENT_INPUT_VOLTAGE),
                    get(table.PRESENT_TEMPERATURE),
                )
                model = model_name(get(table.MODEL_NUMBER))
                out[f"servos: {servo.name}"] = f"{model}, id {servo.id}, {volts:.1f} V, {celsius} C"
        return out

    # ---- torque ----

    def switch_on(self, which: BoolArray) -> list[Finding]:
        """Set servos up, switch their torque on at rest, and arm their watchdog; see `Servos`.

        Raises:
            HardwareError: a servo does not answer, or has a fault.
        """
        chosen = [servo for servo, one in zip(self.servos, which, strict=True) if one]
        self.stop()
        for servo in chosen:
            if servo.id not in self._ready:
                self._set_up(servo)
        self.fault = ""
        self.read()
        if not self.fault:
            self._note_faults()
        if self.fault:
            raise HardwareError(self.fault)
        for servo in chosen:
            self._disable_watchdog(servo.id)
            if not self._torque[self.ids.index(servo.id)]:
                self._bus.write(servo.id, table.TORQUE_ENABLE, 1)
                # a lock of the goals that a tripped watchdog has left ends with the torque
                self._bus.write(servo.id, table.GOAL_VELOCITY, 0)
        for servo in chosen:
            self._bus.write(servo.id, table.BUS_WATCHDOG, self._watchdog_steps)
        if (which & ~self._torque).any():
            _LOG.info("torque on")
        _LOG.info("watchdog armed: %g s", self._watchdog_steps * table.WATCHDOG_S)
        self._torque |= which
        self._rounding_error[:] = 0.0
        changed, self._changed = self._changed, {}
        return [
            Finding(part=f"servos: {', '.join(names)}", problem=problem, warning=True)
            for problem, names in changed.items()
        ]

    def _set_up(self, servo: ServoConfig) -> None:
        bus, ident = self._bus, servo.id
        if bus.read(ident, table.OPERATING_MODE) != table.VELOCITY_MODE:
            if bus.read(ident, table.TORQUE_ENABLE):
                raise HardwareError(
                    f"servos: {servo.name}: expected velocity mode or no torque, got torque in "
                    "another mode: hold the head, and switch its power off and on"
                )
            bus.write(ident, table.OPERATING_MODE, table.VELOCITY_MODE)
            _LOG.info("%s: set to velocity mode", servo.name)
        self._disable_watchdog(ident)
        shutdown = bus.read(ident, table.SHUTDOWN) | _NEEDED_SHUTDOWN
        locked = [
            (register, old, value)
            for register, value in ((table.PWM_LIMIT, table.FULL_PWM), (table.SHUTDOWN, shutdown))
            if (old := bus.read(ident, register)) != value
        ]
        if locked:
            with self._unlocked(servo):
                for change in locked:
                    self._change(servo, *change)
        for register in (table.PROFILE_ACCELERATION, table.PROFILE_VELOCITY, table.GOAL_PWM):
            wanted = bus.read(ident, table.PWM_LIMIT) if register == table.GOAL_PWM else 0
            if (old := bus.read(ident, register)) != wanted:
                self._change(servo, register, old, wanted)
        self._limit_ticks[self.ids.index(ident)] = bus.read(ident, table.VELOCITY_LIMIT)
        if ident not in self._watches:
            self._watches[ident] = HealthWatch(read_limits(bus, ident))
        self._ready.append(ident)

    def _change(self, servo: ServoConfig, register: Register, old: int, value: int) -> None:
        locked = register.address < table.EEPROM_END
        until = "until the end" if locked else "until its power is off"
        done = f"which is set to {value} {until}"
        try:
            self._bus.write(servo.id, register, value)
        except ServoRefusalError:
            done = f"which the servo refuses to change to {value}"
        else:
            if locked:
                self._kept.setdefault(servo.id, {})[register] = old
        problem = f"expected {value} in {register.name}, got {old}, {done}"
        _LOG.info("%s: %s", servo.name, problem)
        self._changed.setdefault(problem, []).append(servo.name)

    @contextmanager
    def _unlocked(self, servo: ServoConfig) -> Iterator[None]:
        """Take a servo's torque while the block runs, if it has any and its joint rests."""
        bus, ident = self._bus, servo.id
        if not bus.read(ident, table.TORQUE_ENABLE):
            yield
            return
        for _ in range(_REST_READS):
            if abs(bus.read(ident, table.PRESENT_VELOCITY)) <= _REST_TICKS:
                break
        else:
            raise HardwareError(
                f"servos: {servo.name}: expected a joint at rest, to change the servo's EEPROM, "
                "got one that moves; cure: hold the head, and switch its power off and on"
            )
        try:
            bus.write(ident, table.TORQUE_ENABLE, 0)
            yield
        finally:
            with suppress(HardwareError):  # it is zero already, and the torque matters more
                bus.write(ident, table.GOAL_VELOCITY, 0)
            bus.write(ident, table.TORQUE_ENABLE, 1)

    def _disable_watchdog(self, ident: int) -> None:
        """Switch a servo's watchdog off, and set its goal to zero velocity.

        Some firmware locks the goals of a servo whose watchdog has tripped until its torque has
        been off: then it is switched off and on, once. If it is off, the lock stays until it is
        switched on.
        """
        self._bus.write(ident, table.BUS_WATCHDOG, 0)
        try:
            self._bus.write(ident, table.GOAL_VELOCITY, 0)
        except ServoRefusalError:
            if self._bus.read(ident, table.TORQUE_ENABLE):
                self._bus.write(ident, table.TORQUE_ENABLE, 0)
                self._bus.write(ident, table.TORQUE_ENABLE, 1)
                self._bus.write(ident, table.GOAL_VELOCITY, 0)

    def release(self, which: BoolArray) -> None:
        """See `Servos.release`.

        Raises:
            HardwareError: a servo does not confirm it.
        """
        for place in np.flatnonzero(which):
            self._bus.write(self.ids[place], table.TORQUE_ENABLE, 0)
            self._torque[place] = False

    # ---- each period ----

    def read(self) -> ServoReading:
        """Read all servos; `fault` says what they tell of themselves, see `Servos`."""
        asked_s = self.clock()
        self._reads += 1
        # every other request is a byte longer: its length exposes a late answer to the one before
        address, length = MOTION_SPAN
        found = self._bus.sync_read(self.ids, address, length + self._reads % 2)
        count = len(self.ids)
        reading = ServoReading(
            # servos measure as the request arrives; adapters only hold their answers back
            asked_s + self._bus.line.wire_s(SYNC_READ_BYTES + count),
            np.zeros(count),
            np.zeros(count),
            np.full(count, np.inf),
        )
        for place, ident in enumerate(self.ids):
            if ident in found:
                data = found[ident]
                speed = table.PRESENT_VELOCITY.decode(data[:4])
                reading.speeds[place] = speed * table.TICK_RAD_S
                reading.angles[place] = table.PRESENT_POSITION.decode(data[4:8]) * table.TICK_RAD
                reading.ages_s[place] = 0.0
                self._missed.pop(ident, None)
            else:
                self._note_missed(self.servos[place], asked_s)
        if self._torque.any() and not self.fault:
            self._note_faults()
        return reading

    def _note_missed(self, servo: ServoConfig, asked_s: float) -> None:
        """Tell of answers that come too late; for none at all see `vergence.hardware.drive`."""
        stale = self._bus.stale[servo.id]
        if servo.id not in self._missed:
            self._stale[servo.id] = stale
        missed = self._missed.setdefault(servo.id, [])
        missed.append(asked_s)
        # the answer to the last request may still be on its way
        late = stale - self._stale[servo.id] >= len(missed) - 1
        silent = self.clock() - missed[0] > SILENT_S and len(missed) >= _STOPPING_MISSES
        if silent and late and not self.fault:
            self.fault = (
                f"servos: {servo.name}: expected an answer of the id {servo.id} on {self.port} "
                f"within {1e3 * self._bus.cycle_timeout_s:.3g} ms, got later ones alone for "
                f"{SILENT_S:g} s; cure: {LATE_ANSWERS_CURE}"
            )

    def _note_faults(self) -> None:
        """Note a servo that announces a fault."""
        for place, servo in enumerate(self.servos):
            if servo.id in self._bus.alerts:
                errors = 0
                with suppress(HardwareError):
                    errors = self._bus.read(servo.id, table.HARDWARE_ERROR_STATUS, requests=1)
                # with a broken encoder its motor turns on at any goal
                self.must_let_go[place] |= bool(errors & _ENCODER_FAULT)
                self.fault = (
                    f"servos: {servo.name}: expected a servo without a fault, got "
                    f"{describe_fault_bits(errors) or 'one that it does not tell'}: it may have "
                    "let go; cure: hold the head, remove the cause, then switch its power off "
                    "and on"
                )
                return

    def _note_lost_torque(self) -> None:
        """Note a servo that has lost its torque, as after a shutdown or a reboot."""
        register = table.TORQUE_ENABLE
        found = self._bus.sync_read(self.ids, register.address, register.length)
        if not self.fault:  # which the same answers may have announced
            self._note_faults()
        for servo, torque in zip(self.servos, self._torque, strict=True):
            if torque and found.get(servo.id) == b"\0" and not self.fault:
                self.fault = (
                    f"servos: {servo.name}: expected the servo with the id {servo.id} to hold its "
                    "torque, got one that has let go, as after a reboot or a loss of power; cure: "
                    "hold the head, and check the plugs of its power"
                )

    def send(self, speeds: FloatArray) -> FloatArray:
        """Send speeds in the servos' unit; see `Servos.send`."""
        exact = speeds / table.TICK_RAD_S
        wanted = exact + self._rounding_error
        ticks = np.clip(np.rint(wanted), -self._limit_ticks, self._limit_ticks)
        still = np.abs(exact) < _ZERO_COMMAND_TICKS
        self._rounding_error = np.where(still, 0.0, np.clip(wanted - ticks, -1.0, 1.0))
        ticks = np.where(still | ~self._torque, 0.0, ticks)
        on = {
            one: int(n)
            for one, n, torque in zip(self.ids, ticks, self._torque, strict=True)
            if torque
        }
        if on:
            self._bus.sync_write(table.GOAL_VELOCITY, on)
            self._sends += 1
            if self._sends % _TORQUE_READ_PERIODS == 0:  # after the command, which it delays not
                self._note_lost_torque()
        return np.asarray(ticks * table.TICK_RAD_S)

    def stop(self) -> None:
        """Broadcast zero velocity; see `Servos.stop`."""
        for _ in range(_ZERO_REPEATS):
            self._bus.sync_write(table.GOAL_VELOCITY, dict.fromkeys(self.ids, 0))

    def leave(self) -> None:
        """Switch the watchdog of each servo off that confirms rest; see `Servos.leave`."""
        for ident in self._ready:
            with suppress(HardwareError):
                try:
                    self._bus.write(ident, table.GOAL_VELOCITY, 0)
                except ServoRefusalError:
                    # a servo whose watchdog has tripped accepts no goal until its watchdog is off
                    if self._bus.read(ident, table.BUS_WATCHDOG) not in (0, table.WATCHDOG_TRIPPED):
                        continue
                self._disable_watchdog(ident)

    def stopped_alone(self, pause_s: float) -> bool:
        """True if the watchdog of a servo has tripped; see `Servos.stopped_alone`."""
        states = [self._bus.read(one, table.BUS_WATCHDOG, requests=2) for one in self.ids]
        return table.WATCHDOG_TRIPPED in states

    def close(self) -> None:
        """Put back what was in the EEPROM of the servos, and release the line; see `Servos`."""
        line = self._line
        if line is None:
            return
        try:
            if os.getpid() == self._pid:
                for servo in self.servos:
                    self._put_back(servo)
        finally:
            self._line = None
            line.close()

    def _put_back(self, servo: ServoConfig) -> None:
        kept = self._kept.pop(servo.id, {})
        if not kept:
            return
        try:
            with self._unlocked(servo):
                for register, value in kept.items():
                    self._bus.write(servo.id, register, value)
        except HardwareError as error:
            first = ", ".join(f"{register.name} {value}" for register, value in kept.items())
            got = str(error).removeprefix(f"servos: {servo.name}: ")
            text = f"servos: {servo.name}: expected to put back {first} at the end, got {got}"
            # `warned` marks the log line, so that a terminal does not show the warning twice
            _LOG.warning("%s", text, extra={"warned": True})
            warnings.warn(text, VergenceWarning, stacklevel=3)
