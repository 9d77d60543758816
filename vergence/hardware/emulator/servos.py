"""Emulated Dynamixel X-series servos: a control table each, and a joint that moves by it.

Nothing here reads a clock or does I/O: `ServoLine.answer` takes a packet and the time at which it
came, and gives the bytes that the servos would send.

Emulated are velocity and position modes, the locks and ranges of registers, the bus watchdog, the
status return level and the hardware errors' alert. Not emulated, and refused where they are asked
for: other modes, the reverse bit of DRIVE_MODE, registered instructions, fast and bulk reads.
Profiles, gains and RETURN_DELAY_TIME are memory without effect.
"""

from collections.abc import Iterable, Iterator
from math import exp, inf
from typing import Final

import numpy as np

from vergence.errors import ConfigurationError
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.control_table import TICK_RAD, TICK_RAD_S, Register
from vergence.hardware.dynamixel.packets import (
    ALERT,
    BROADCAST,
    ErrorNumber,
    Instruction,
    Packet,
    status_packet,
)
from vergence.models.joint_response import follow_joint
from vergence.models.parts import FloatArray

POSITION_GAIN: Final = 20.0
"""Gain of the loop in the position modes, 1/s: plausible, and not measured on a real servo."""
STEP_S: Final = 0.002
"""Longest step while a joint's velocity changes, s: a tenth of the lag of a quick servo."""

_STILL: Final = 1e-12
"""Change in a step below which a state counts as steady, rad and rad/s."""
_END: Final = 661
"""Address behind an XL430-W250's last register."""
_MOST_READ: Final = 256
"""Bytes to read at once whose status fits into a packet however much is stuffed."""
_REPORT: Final = slice(120, 147)
"""What the servo reports and nobody writes: REALTIME_TICK to PRESENT_TEMPERATURE."""
_EXTENDED: Final = 1_048_575
"""Greatest position in extended position mode: 256 turns."""

_follow = getattr(follow_joint, "py_func", follow_joint)

_FACTORY: Final = {
    table.MODEL_NUMBER: 1060,
    table.FIRMWARE_VERSION: 45,
    table.ID: 1,
    table.BAUD_RATE: 1,
    table.RETURN_DELAY_TIME: 250,
    table.OPERATING_MODE: table.POSITION_MODE,
    table.PROTOCOL_TYPE: 2,
    table.TEMPERATURE_LIMIT: 72,
    table.MAX_VOLTAGE_LIMIT: 140,
    table.MIN_VOLTAGE_LIMIT: 60,
    table.VELOCITY_LIMIT: 265,
    table.MAX_POSITION_LIMIT: 4095,
    table.SHUTDOWN: 0b110100,
    table.STATUS_RETURN_LEVEL: 2,
    table.GOAL_PWM: 885,
    table.PRESENT_INPUT_VOLTAGE: 120,
    table.PRESENT_TEMPERATURE: 31,
}
"""An XL430-W250 as it comes, at 12 V and 31 degrees; what is not here is 0."""

_RANGES: Final = {
    table.ID: (0, 252),
    table.BAUD_RATE: (0, 7),
    table.RETURN_DELAY_TIME: (0, 254),
    table.DRIVE_MODE: (0, 0),
    table.PROTOCOL_TYPE: (2, 2),
    table.HOMING_OFFSET: (-1_044_479, 1_044_479),
    table.VELOCITY_LIMIT: (0, 1023),
    table.MAX_POSITION_LIMIT: (0, 4095),
    table.MIN_POSITION_LIMIT: (0, 4095),
    table.TORQUE_ENABLE: (0, 1),
    table.STATUS_RETURN_LEVEL: (0, 2),
    table.BUS_WATCHDOG: (0, table.WATCHDOG_MOST),
}
_MODES: Final = (table.VELOCITY_MODE, table.POSITION_MODE, table.EXTENDED_POSITION_MODE)
_READ_ONLY: Final = (table.MODEL_NUMBER, table.FIRMWARE_VERSION, table.HARDWARE_ERROR_STATUS)
_GOALS: Final = (table.GOAL_PWM, table.GOAL_VELOCITY, table.GOAL_POSITION)


class Servo:
    """One servo and the joint that it moves.

    Angles are the joint's: the servo's position in ticks is
    `zero_ticks + sign gear_ratio angle / TICK_RAD + HOMING_OFFSET`.

    Args:
        id: on the line.
        lag_s: time constant of the joint's velocity, s.
        acceleration: greatest, of the joint, rad/s^2.
        lower: lower end stop of the joint, rad.
        upper: upper end stop, rad.
        sign: 1, or -1 if the servo turns against the joint.
        zero_ticks: the servo's position where the joint's angle is 0.
        gear_ratio: turns of the servo in one of the joint.
        speed_filter_s: time constant of the low-pass filter on PRESENT_VELOCITY, s; 0 for none.
        position_rad: the joint's angle at the start.

    Attributes:
        table: the control table's bytes.
        q: the joint's angle, rad.
        v: the joint's velocity, rad/s.
        trips: how often the watchdog has stopped it.
        silent: whether it answers nothing and obeys nothing, as with its plug pulled out.

    Raises:
        ConfigurationError: a sign other than 1 and -1, or a gear ratio or lag that is not positive.
    """

    def __init__(
        self,
        id: int,
        *,
        lag_s: float,
        acceleration: float = inf,
        lower: float = -inf,
        upper: float = inf,
        sign: int = 1,
        zero_ticks: int = table.CENTRE_TICKS,
        gear_ratio: float = 1.0,
        speed_filter_s: float = 0.0,
        position_rad: float = 0.0,
    ) -> None:
        if sign not in (1, -1):
            raise ConfigurationError(f"servo.sign: expected 1 or -1, got {sign}")
        for name, value in (("gear_ratio", gear_ratio), ("lag_s", lag_s)):
            if not value > 0.0:
                raise ConfigurationError(f"servo.{name}: expected more than 0, got {value}")
        self.lag_s, self.acceleration = lag_s, acceleration
        self.lower, self.upper = lower, upper
        self.zero_ticks, self.speed_filter_s = zero_ticks, speed_filter_s
        self.q, self.v = position_rad, 0.0
        self.trips, self.silent = 0, False
        self._turns = sign * gear_ratio
        self._reported = 0.0  # velocity behind the filter, rad/s
        self._at_s: float | None = None  # None until time begins
        self._fed_s = 0.0
        self._tripped = False
        self.table = bytearray(_END)
        for register, value in _FACTORY.items():
            self.set(register, value)
        self.set(table.ID, id)
        self._hold()

    @property
    def id(self) -> int:
        """Whom it listens to as."""
        return self.table[table.ID.address]

    def get(self, register: Register) -> int:
        """A register's number."""
        return register.decode(self.table[register.address : register.end])

    def set(self, register: Register, value: int) -> None:
        """Set a register's number, past all locks and ranges."""
        self.table[register.address : register.end] = register.encode(value)

    def fail(self, errors: int) -> None:
        """Have hardware errors, as bits of HARDWARE_ERROR_STATUS: torque goes off."""
        self.set(table.HARDWARE_ERROR_STATUS, errors)
        self.set(table.TORQUE_ENABLE, 0)

    def feed(self, now_s: float) -> None:
        """Hear an instruction packet, whomever it is for: the watchdog counts from here."""
        self._fed_s = now_s

    def to(self, now_s: float) -> None:
        """Bring the joint to a time, by way of the watchdog's instant if that comes first."""
        if self._at_s is None:
            self._at_s = self._fed_s = now_s
        at_s = self._at_s
        while at_s < now_s:
            until_s = now_s
            if (due_s := self._due_s()) <= at_s:
                self._trip()
            else:
                until_s = min(now_s, due_s)
            self._move(until_s - at_s)
            self._at_s = at_s = until_s
        # at the instant itself: an instruction at that very time comes too late
        if self._due_s() <= at_s:
            self._trip()

    def read(self, address: int, length: int) -> tuple[int, bytes]:
        """Error and bytes that an instruction to read gives."""
        if not 0 < length <= _MOST_READ or address + length > _END:
            return ErrorNumber.DATA_RANGE, b""
        self._report()
        return 0, bytes(self.table[address : address + length])

    def write(self, address: int, data: bytes) -> int:
        """Error that an instruction to write gives; nothing is written then."""
        end = address + len(data)
        error = self._refusal(address, end, data)
        if error:
            return error
        before = self.get(table.TORQUE_ENABLE), self.get(table.OPERATING_MODE)
        self.table[address:end] = data
        if address <= table.BUS_WATCHDOG.address < end:
            self._tripped = False  # 0, or it was refused while tripped
        if before != (self.get(table.TORQUE_ENABLE), self.get(table.OPERATING_MODE)):
            self._hold()
        return 0

    def reboot(self) -> None:
        """Begin anew with what the EEPROM has."""
        self.table[table.EEPROM_END :] = bytes(_END - table.EEPROM_END)
        for register, value in _FACTORY.items():
            if register.address >= table.EEPROM_END:
                self.set(register, value)
        self._tripped = False
        self._hold()

    def _ticks(self) -> int:
        ticks = self.zero_ticks + self._turns * self.q / TICK_RAD
        position = table.PRESENT_POSITION
        whole = round(ticks) + self.get(table.HOMING_OFFSET)
        return (whole - position.least) % (1 << 32) + position.least  # a wheel's wraps in days

    def _angle(self, ticks: int) -> float:
        ticks -= self.zero_ticks + self.get(table.HOMING_OFFSET)
        return ticks * TICK_RAD / self._turns

    def _report(self) -> None:
        """Write what the servo measures into its table."""
        self.set(table.PRESENT_POSITION, self._ticks())
        self.set(table.PRESENT_VELOCITY, round(self._turns * self._reported / TICK_RAD_S))
        self.set(table.MOVING, int(abs(self._turns * self.v) > TICK_RAD_S))

    def _hold(self) -> None:
        """Goals of a servo whose torque or mode was switched: to stay where it is."""
        self.set(table.GOAL_VELOCITY, 0)
        self.set(table.GOAL_POSITION, self._ticks())

    def _due_s(self) -> float:
        """When the watchdog stops the servo, unless somebody speaks."""
        period = self.get(table.BUS_WATCHDOG)
        if period <= 0 or not self.get(table.TORQUE_ENABLE):
            return inf
        return self._fed_s + table.WATCHDOG_S * period

    def _trip(self) -> None:
        self._hold()
        self.set(table.BUS_WATCHDOG, table.WATCHDOG_TRIPPED)
        self._tripped = True
        self.trips += 1

    def _command(self) -> float:
        """The joint's commanded velocity, rad/s."""
        if self._tripped or not self.get(table.TORQUE_ENABLE):
            return 0.0
        if self.get(table.OPERATING_MODE) == table.VELOCITY_MODE:
            return self.get(table.GOAL_VELOCITY) * TICK_RAD_S / self._turns
        limit = self.get(table.VELOCITY_LIMIT) * TICK_RAD_S / abs(self._turns)
        wanted = POSITION_GAIN * (self._angle(self.get(table.GOAL_POSITION)) - self.q)
        return min(max(wanted, -limit), limit)

    def _move(self, time_s: float) -> None:
        """Move by what the goals say for a time in which nobody speaks."""
        step_s = min(STEP_S, time_s)
        while time_s > 0.0:
            before = self.q, self.v, self._reported
            self._step(min(step_s, time_s))
            time_s -= step_s
            now = self.q, self.v, self._reported
            change = [abs(new - old) for new, old in zip(now, before, strict=True)]
            if max(change) < _STILL:
                return
            # at a steady velocity one step does, up to the end stop
            step_s = STEP_S
            if max(change[1:]) < _STILL and abs(self._command() - self.v) < _STILL:
                stop = self.upper if self.v > 0.0 else self.lower
                step_s = max(STEP_S, (stop - self.q) / self.v)

    def _step(self, step_s: float) -> None:
        decay = exp(-step_s / self.lag_s)
        command = self._command()
        self.q, self.v = _follow(
            self.q, self.v, command, self.lag_s, self.acceleration, step_s, decay
        )
        if not self.lower <= self.q <= self.upper:
            self.q, self.v = min(max(self.q, self.lower), self.upper), 0.0
        kept = exp(-step_s / self.speed_filter_s) if self.speed_filter_s > 0.0 else 0.0
        self._reported = self.v + kept * (self._reported - self.v)

    def _refusal(self, address: int, end: int, data: bytes) -> int:
        """Error of writing these bytes, 0 for none."""
        if end > _END:
            return ErrorNumber.DATA_RANGE
        if end == address:
            return ErrorNumber.DATA_LENGTH
        locked = address < table.EEPROM_END and self.get(table.TORQUE_ENABLE)
        if locked or (address < _REPORT.stop and end > _REPORT.start):
            return ErrorNumber.ACCESS
        for register in table.REGISTERS:
            if register.end <= address or end <= register.address:
                continue
            if register in _READ_ONLY:
                return ErrorNumber.ACCESS
            if register.address < address or end < register.end:
                return ErrorNumber.DATA_LENGTH
            value = register.decode(data[register.address - address : register.end - address])
            if error := self._out_of_range(register, value):
                return error
        return 0

    def _out_of_range(self, register: Register, value: int) -> int:
        least, most = _RANGES.get(register, (register.least, register.most))
        if not least <= value <= most:
            return ErrorNumber.DATA_RANGE
        if register == table.OPERATING_MODE and value not in _MODES:
            return ErrorNumber.DATA_RANGE
        if self._tripped and (register in _GOALS or (register == table.BUS_WATCHDOG and value)):
            # the manual of BUS_WATCHDOG has a range error for goals then, not an access error
            return ErrorNumber.DATA_RANGE
        least, most = self._limits(register)
        return 0 if least <= value <= most else ErrorNumber.DATA_LIMIT

    def _limits(self, register: Register) -> tuple[int, int]:
        """What the servo's own settings leave of a goal's range."""
        if register == table.GOAL_VELOCITY:
            limit = self.get(table.VELOCITY_LIMIT)
            return -limit, limit
        if register == table.GOAL_POSITION:
            mode = self.get(table.OPERATING_MODE)
            if mode == table.POSITION_MODE:
                return self.get(table.MIN_POSITION_LIMIT), self.get(table.MAX_POSITION_LIMIT)
            if mode == table.EXTENDED_POSITION_MODE:
                return -_EXTENDED, _EXTENDED
        return register.least, register.most


class ServoLine:
    """Servos that share a line.

    A servo that is silent does not keep those after it from answering a sync read.

    Args:
        servos: each with an id of its own.

    Raises:
        ConfigurationError: two servos have one id.
    """

    def __init__(self, servos: Iterable[Servo]) -> None:
        self.servos = tuple(servos)
        ids = [servo.id for servo in self.servos]
        if len(set(ids)) < len(ids):
            raise ConfigurationError(f"servos: expected an id of its own for each, got {ids}")

    @property
    def trips(self) -> int:
        """How often watchdogs have stopped servos."""
        return sum(servo.trips for servo in self.servos)

    def to(self, now_s: float) -> None:
        """Bring all joints to a time, s; an earlier one than before changes nothing."""
        for servo in self.servos:
            servo.to(now_s)

    def positions(self) -> FloatArray:
        """True angles of the joints, rad, shape (n,)."""
        return np.array([servo.q for servo in self.servos])

    def velocities(self) -> FloatArray:
        """True velocities of the joints, rad/s, shape (n,)."""
        return np.array([servo.v for servo in self.servos])

    def answer(self, packet: Packet, now_s: float) -> bytes:
        """All status packets that a packet brings about.

        Args:
            packet: from the line, whatever it holds.
            now_s: when it came, on the clock of `to`.
        """
        self.to(now_s)
        if packet.instruction == Instruction.STATUS:
            return b""
        present = [servo for servo in self.servos if not servo.silent]
        for servo in present:
            servo.feed(now_s)
        if packet.instruction == Instruction.SYNC_READ:
            return b"".join(_sync_read(present, packet))
        if packet.instruction == Instruction.SYNC_WRITE:
            _sync_write(present, packet)
            return b""
        addressed = [servo for servo in present if packet.id in (servo.id, BROADCAST)]
        return b"".join(_execute(servo, packet) for servo in addressed)


def _execute(servo: Servo, packet: Packet) -> bytes:
    """Carry out an instruction to one servo, and say so where its return level asks for it."""
    level, id = servo.get(table.STATUS_RETURN_LEVEL), servo.id
    params, data, error = packet.params, b"", 0
    least_level = 2
    if packet.instruction == Instruction.PING:
        least_level = 0
        data = bytes(servo.table[0:2]) + bytes(servo.table[6:7])
    elif packet.instruction == Instruction.READ:
        least_level = 1
        if len(params) == 4:
            error, data = servo.read(_number(params, 0), _number(params, 2))
        else:
            error = ErrorNumber.DATA_LENGTH
    elif packet.instruction == Instruction.WRITE:
        short = len(params) < 2
        error = ErrorNumber.DATA_LENGTH if short else servo.write(_number(params, 0), params[2:])
    elif packet.instruction == Instruction.REBOOT:
        servo.reboot()
    else:
        error = ErrorNumber.INSTRUCTION
    quiet = level < least_level or (packet.id == BROADCAST and least_level > 0)
    return b"" if quiet else _status(servo, id, data, error)


def _sync_read(servos: list[Servo], packet: Packet) -> Iterator[bytes]:
    if packet.id != BROADCAST or len(packet.params) < 4:
        return
    address, length = _number(packet.params, 0), _number(packet.params, 2)
    by_id = {servo.id: servo for servo in servos}
    for id in packet.params[4:]:
        if id in by_id and by_id[id].get(table.STATUS_RETURN_LEVEL) >= 1:
            error, data = by_id[id].read(address, length)
            yield _status(by_id[id], id, data, error)


def _sync_write(servos: list[Servo], packet: Packet) -> None:
    if packet.id != BROADCAST or len(packet.params) < 4:
        return
    address, length = _number(packet.params, 0), _number(packet.params, 2)
    by_id = {servo.id: servo for servo in servos}
    for at in range(4, len(packet.params) - length, length + 1):
        servo = by_id.get(packet.params[at])
        if servo is not None:
            servo.write(address, packet.params[at + 1 : at + 1 + length])


def _status(servo: Servo, id: int, data: bytes, error: int) -> bytes:
    alert = ALERT if servo.get(table.HARDWARE_ERROR_STATUS) else 0
    return status_packet(id, data, error | alert)


def _number(params: bytes, at: int) -> int:
    return int.from_bytes(params[at : at + 2], "little")
