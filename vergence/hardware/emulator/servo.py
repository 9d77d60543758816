"""An emulated Dynamixel X-series servo: a control table, and the joint that it drives.

Nothing here reads a clock or does I/O.

Emulated are velocity and position modes, the locks and ranges of registers, the bus watchdog, and
the errors of voltage, temperature and load with the shutdown that SHUTDOWN configures. An error
lasts until a reboot; until then torque cannot be switched on. A reboot takes no time; after it the
position is reported within one turn again, as the encoder is absolute within one turn only.

Not emulated, and refused with an error: other modes and the reverse bit of DRIVE_MODE. Gain
registers have no effect. A servo moves by the package's joint law, and comes to rest with its lag
when it loses torque; friction, gravity, a blind encoder or an inverted motor need `Motor`.
"""

from array import array
from bisect import bisect_right
from collections.abc import Iterable
from math import cos, exp, inf, pi
from typing import Final, NamedTuple

from vergence.errors import ConfigurationError
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.control_table import TICK_RAD, TICK_RAD_S, Register
from vergence.hardware.dynamixel.packets import ErrorNumber
from vergence.models.motion import follow_joint

_TABLE_END: Final = 661
"""Address after the last register (physical: XL430-W250)."""
_MAX_READ_BYTES: Final = 256
"""Most bytes per read: their status fits into a packet with any byte stuffing (chosen)."""
_MEASUREMENT_ADDRESSES: Final = slice(120, 147)
"""Addresses of measurements, which nobody writes: REALTIME_TICK to PRESENT_TEMPERATURE (physical:
Dynamixel X series)."""
_MAX_EXTENDED_POSITION: Final = 1_048_575
"""Greatest position in extended position mode, ticks: 256 turns (physical: XL430-W250)."""

_FACTORY_VALUES: Final = {
    table.MODEL_NUMBER: 1060, table.FIRMWARE_VERSION: 45, table.ID: 1, table.BAUD_RATE: 1,
    table.RETURN_DELAY_TIME: 250, table.OPERATING_MODE: table.POSITION_MODE,
    table.SECONDARY_ID: 255, table.PROTOCOL_TYPE: 2, table.TEMPERATURE_LIMIT: 72,
    table.MAX_VOLTAGE_LIMIT: 140, table.MIN_VOLTAGE_LIMIT: 60, table.PWM_LIMIT: table.FULL_PWM,
    table.VELOCITY_LIMIT: 265, table.MAX_POSITION_LIMIT: 4095, table.SHUTDOWN: 0b110100,
    table.STATUS_RETURN_LEVEL: 2, table.VELOCITY_I_GAIN: 1000, table.VELOCITY_P_GAIN: 100,
    table.GOAL_PWM: table.FULL_PWM, table.PRESENT_INPUT_VOLTAGE: 120, table.PRESENT_TEMPERATURE: 31,
}  # fmt: skip
"""Factory values of an XL430-W250, at 12 V and 31 degrees Celsius; other registers are 0."""

_RANGES: Final = {
    table.ID: (0, 252), table.BAUD_RATE: (0, len(table.BAUD_RATES) - 1),
    table.RETURN_DELAY_TIME: (0, 254), table.DRIVE_MODE: (0, 0), table.PROTOCOL_TYPE: (2, 2),
    table.HOMING_OFFSET: (-1_044_479, 1_044_479), table.TEMPERATURE_LIMIT: (0, 100),
    table.MAX_VOLTAGE_LIMIT: (60, 140), table.MIN_VOLTAGE_LIMIT: (60, 140),
    table.PWM_LIMIT: (0, table.FULL_PWM), table.VELOCITY_LIMIT: (0, 2047),
    table.MAX_POSITION_LIMIT: (0, 4095), table.MIN_POSITION_LIMIT: (0, 4095),
    table.TORQUE_ENABLE: (0, 1), table.STATUS_RETURN_LEVEL: (0, 2),
    table.VELOCITY_I_GAIN: (0, 16_383), table.VELOCITY_P_GAIN: (0, 16_383),
    table.BUS_WATCHDOG: (0, table.WATCHDOG_MOST), table.PROFILE_ACCELERATION: (0, 32_767),
    table.PROFILE_VELOCITY: (0, 32_767),
}  # fmt: skip
_LIMITS: Final = {table.GOAL_VELOCITY: table.VELOCITY_LIMIT, table.GOAL_PWM: table.PWM_LIMIT}
_MODES: Final = (table.VELOCITY_MODE, table.POSITION_MODE, table.EXTENDED_POSITION_MODE)
_READ_ONLY: Final = (table.MODEL_NUMBER, table.FIRMWARE_VERSION, table.HARDWARE_ERROR_STATUS)


class ControlTable:
    """The bytes of a servo's registers, with their locks and ranges."""

    def __init__(self, id: int) -> None:
        self.bytes = bytearray(_TABLE_END)
        for register, value in _FACTORY_VALUES.items():
            self.set(register, value)
        self.set(table.ID, id)

    def get(self, register: Register) -> int:
        """Value of a register."""
        return register.decode(self.bytes[register.address : register.end])

    def set(self, register: Register, value: int) -> None:
        """Set a register, without checks of locks and ranges."""
        self.bytes[register.address : register.end] = register.encode(value)

    def reboot(self) -> None:
        """Reset all registers but the EEPROM and the measurements."""
        measured = self.bytes[_MEASUREMENT_ADDRESSES]
        self.bytes[table.EEPROM_END :] = bytes(_TABLE_END - table.EEPROM_END)
        for register, value in _FACTORY_VALUES.items():
            if register.address >= table.EEPROM_END:
                self.set(register, value)
        self.bytes[_MEASUREMENT_ADDRESSES] = measured

    def refusal(self, address: int, data: bytes) -> int:
        """Error number of an instruction to write these bytes; 0 for none."""
        end = address + len(data)
        if end > _TABLE_END:
            return ErrorNumber.DATA_RANGE
        if not data:
            return ErrorNumber.DATA_LENGTH
        locked = address < table.EEPROM_END and self.get(table.TORQUE_ENABLE)
        if locked or (address < _MEASUREMENT_ADDRESSES.stop and end > _MEASUREMENT_ADDRESSES.start):
            return ErrorNumber.ACCESS
        for register in table.REGISTERS:
            if register.end <= address or end <= register.address:
                continue
            if register in _READ_ONLY:
                return ErrorNumber.ACCESS
            value = written_value(register, address, data)
            if value is None:
                return ErrorNumber.DATA_LENGTH
            if error := self._out_of_range(register, value):
                return error
        return 0

    def _out_of_range(self, register: Register, value: int) -> int:
        least, most = _RANGES.get(register, (register.least, register.most))
        unknown_mode = register == table.OPERATING_MODE and value not in _MODES
        if unknown_mode or not least <= value <= most:
            return ErrorNumber.DATA_RANGE
        # the servo's own settings limit its goals
        mode = self.get(table.OPERATING_MODE)
        if register in _LIMITS:
            least, most = -self.get(_LIMITS[register]), self.get(_LIMITS[register])
        elif register == table.GOAL_POSITION and mode == table.POSITION_MODE:
            least, most = self.get(table.MIN_POSITION_LIMIT), self.get(table.MAX_POSITION_LIMIT)
        elif register == table.GOAL_POSITION and mode == table.EXTENDED_POSITION_MODE:
            least, most = -_MAX_EXTENDED_POSITION, _MAX_EXTENDED_POSITION
        return 0 if least <= value <= most else ErrorNumber.DATA_LIMIT


def written_value(register: Register, address: int, data: bytes) -> int | None:
    """Value that bytes at an address write into a register; None unless they cover all of it."""
    at = register.address - address
    if not 0 <= at <= len(data) - register.length:
        return None
    return register.decode(data[at : at + register.length])


_STATIC_RATIO: Final = 1.6
"""Static friction per Coulomb friction (chosen: of geared servos)."""
_MOTOR_STEP_S: Final = 5e-4
"""Integration step, s: a tenth of the shortest time constant here (numerical)."""
_NO_LOAD_RATIO: Final = 1.15
"""Speed without load, v_0, per greatest speed of the joint (chosen)."""
_STALL_RATIO: Final = 1.5
"""Torque at full duty and no speed, per greatest torque, which the current limits (chosen)."""
_MIN_TIME_CONSTANT_S: Final = 0.02
"""Least time constant of the motor, s (numerical)."""


class Motor:
    """One motor and its velocity PI, with back-EMF, friction and gravity.

    With the greatest torque as an acceleration a, the velocity seen by the inner loop v_s, the goal
    u and the motor's time constant T,

        dv/dt = clip(d - v / T, -a, a) - friction - g a cos(q)
        d = (e + I / T) / lag,    dI/dt = e,    e = u - v_s,    |d| <= v_0 / T

    Since the PI's zero cancels the motor's pole, the response without friction and saturation is
    that of `vergence.models.motion`, a lag. Friction opposes the motion by f a; a joint at rest
    stays there up to `_STATIC_RATIO` f a. A loop whose encoder is blind (v_s = 0) never sees its
    goal reached: its integral grows, and remains at a goal of zero. With an inverted motor (-d) the
    loop runs away.
    """

    def __init__(
        self, lag_s: float, acceleration: float, max_speed: float,
        friction: float = 0.0, gravity: float = 0.0,
    ) -> None:  # fmt: skip
        self.friction, self.gravity = friction, gravity
        self._lag_s, self._acceleration = lag_s, acceleration
        no_load = _NO_LOAD_RATIO * max_speed
        self._time_s = max(no_load / (_STALL_RATIO * acceleration), _MIN_TIME_CONSTANT_S)
        self._full_drive = no_load / self._time_s
        self.integral_s = self._time_s
        self._integral = 0.0

    def reset(self, v: float) -> None:
        """Set the integral to that of a steady velocity, rad/s."""
        self._integral = self._lag_s * v * self.integral_s / self._time_s

    def step(
        self, q: float, v: float, goal: float | None, step_s: float,
        *, blind: bool, inverted: bool, duty: float,
    ) -> tuple[float, float]:  # fmt: skip
        """Angle and velocity after a step towards a goal velocity; None without torque."""
        a = self._acceleration
        if goal is None:
            self._integral, torque = 0.0, -v / self._lag_s
        else:
            error = goal if blind else goal - v
            drive = (error + self._integral / self.integral_s) / self._lag_s
            most = duty * self._full_drive
            if abs(drive) < most or drive * error < 0.0:  # no windup
                self._integral += error * step_s
            drive = min(max(drive, -most), most)
            torque = min(max((-drive if inverted else drive) - v / self._time_s, -a), a)
        torque -= self.gravity * a * cos(q)
        friction = self.friction * a
        if v == 0.0 and abs(torque) <= _STATIC_RATIO * friction:
            return q, 0.0
        side = 1.0 if (v or torque) > 0.0 else -1.0
        after = v + torque * step_s - side * (friction * step_s)
        if v and after * v <= 0.0:  # friction holds where the joint turns round
            after = 0.0
        return q + 0.5 * (v + after) * step_s, after


REST_RAD_S: Final = TICK_RAD_S
"""Greatest speed at rest: one unit of the servos' speed, 0.024 rad/s (physical: X series)."""
_MIN_KEPT_SAMPLES: Final = 16_384
"""Least number of samples kept: 20 s of a joint whose speed always changes (numerical)."""


class MotionSample(NamedTuple):
    """Time, angle and velocity of a joint."""

    time_s: float
    position_rad: float
    velocity_rad_s: float


class MotionTrace:
    """Samples of a joint's motion in the last 20 s or more.

    Callers add samples so often that the velocity changes monotonically between two.
    """

    def __init__(self) -> None:
        # plain numbers: so many objects would make garbage collection delay the servos' answers
        self._columns = array("d"), array("d"), array("d")

    def add(self, *sample: float) -> None:
        """Add a sample; of samples with equal velocity only the first and the last are kept."""
        times, positions, velocities = self._columns
        if len(times) >= 2 and velocities[-2] == velocities[-1] == sample[2]:
            times[-1], positions[-1] = sample[:2]
            return
        for column, value in zip(self._columns, sample, strict=True):
            if len(column) >= 2 * _MIN_KEPT_SAMPLES:
                del column[:_MIN_KEPT_SAMPLES]
            column.append(value)

    def samples_since(self, time_s: float) -> list[MotionSample]:
        """Samples from a time on, the first one interpolated at that time."""
        first = bisect_right(self._columns[0], time_s)
        columns = (column[max(first - 1, 0) :] for column in self._columns)
        samples = [MotionSample(*row) for row in zip(*columns, strict=True)]
        if first > 0 and len(samples) > 1:
            before, after = samples[:2]
            share = (time_s - before.time_s) / (after.time_s - before.time_s)
            samples[0] = MotionSample(
                time_s,
                before.position_rad + share * (after.position_rad - before.position_rad),
                before.velocity_rad_s + share * (after.velocity_rad_s - before.velocity_rad_s),
            )
        return samples


def rest_start_s(traces: Iterable[MotionTrace], time_s: float) -> float | None:
    """Time from `time_s` on after which no joint was faster than `REST_RAD_S`; None if one is."""
    begun_s = [time_s]
    for trace in traces:
        samples = trace.samples_since(time_s)
        fast = [i for i, one in enumerate(samples) if abs(one.velocity_rad_s) > REST_RAD_S]
        if not fast:
            continue
        if fast[-1] == len(samples) - 1:
            return None
        last, after = samples[fast[-1] : fast[-1] + 2]
        speed, slower = abs(last.velocity_rad_s), abs(after.velocity_rad_s)
        share = (speed - REST_RAD_S) / (speed - slower)
        begun_s.append(last.time_s + share * (after.time_s - last.time_s))
    return max(begun_s)


POSITION_GAIN: Final = 20.0
"""Gain of the position loop, 1/s: plausible, not taken from a real servo (chosen)."""
_MAX_STEP_S: Final = 0.002
"""Longest step while a joint's velocity changes, s: a tenth of a quick servo's lag (numerical)."""
# Bits of HARDWARE_ERROR_STATUS and SHUTDOWN (physical: Dynamixel X series).
VOLTAGE_ERROR: Final = 1 << 0
HEAT_ERROR: Final = 1 << 2
ENCODER_ERROR: Final = 1 << 3
LOAD_ERROR: Final = 1 << 5

_PROFILE_UNIT_RAD_S2: Final = 214.577 * 2 * pi / 3600
"""Unit of PROFILE_ACCELERATION, 214.577 rev/min^2 in rad/s^2 (physical: Dynamixel X series)."""
_STIFF_RAD_S2: Final = 1e3
"""Greatest acceleration of a motor without a limit, rad/s^2 (numerical)."""
_STEADY_CHANGE: Final = 1e-12
"""Change per step below which a state counts as steady, rad and rad/s (numerical)."""
_GOAL_REGISTERS: Final = (table.GOAL_PWM, table.GOAL_VELOCITY, table.GOAL_POSITION)

_follow = getattr(follow_joint, "py_func", follow_joint)


class EmulatedServo(ControlTable):
    """One servo and the joint that it moves.

    The servo's position in ticks is `zero_ticks + sign gear_ratio angle / TICK_RAD +
    HOMING_OFFSET`. `q` and `v` are the shaft's angle, rad, and velocity, whose past `trace` has;
    for `friction` and `gravity` see `Motor`. The encoder is on the shaft, which pushes the joint at
    the ends of the backlash. What it reports is `feedback_latency_s` old, its speed behind a
    low-pass filter.

    Raises:
        ConfigurationError: a lag that is not positive.
    """

    def __init__(
        self, id: int, *, lag_s: float, acceleration: float = inf,
        lower: float = -inf, upper: float = inf,
        sign: int = 1, zero_ticks: int = table.CENTRE_TICKS, gear_ratio: float = 1.0,
        speed_filter_s: float = 0.0, speed_gain: float = 1.0, backlash_rad: float = 0.0,
        feedback_latency_s: float = 0.0, max_speed: float = 6.0,
        friction: float = 0.0, gravity: float = 0.0, position_rad: float = 0.0,
    ) -> None:  # fmt: skip
        if not lag_s > 0.0:
            raise ConfigurationError(f"servo.lag_s: expected more than 0, got {lag_s}")
        super().__init__(id)
        self.lag_s, self.acceleration = lag_s, acceleration
        self.lower, self.upper, self.zero_ticks = lower, upper, zero_ticks
        self.speed_filter_s, self.feedback_latency_s = speed_filter_s, feedback_latency_s
        self.speed_gain, self.backlash_rad = speed_gain, backlash_rad
        self.q = self._joint = position_rad
        self.v = 0.0
        self.watchdog_trips = 0
        # faults, see `vergence.hardware.emulator.faults.Fault`
        self.silent = self.stuck = self.frozen = self.inverted = False
        self.blind = False  # the inner loop sees no motion; with `frozen`
        self.goal_scale = 1.0  # the joint's speed by its goal
        self.speed_scale = 1.0  # reported by true speed
        self.eeprom_write_s = 0.0  # time for writing to its EEPROM before it answers
        self.trip_needs_torque_cycle = False  # to unlock the goals, as in some firmware
        self._motor = Motor(lag_s, min(acceleration, _STIFF_RAD_S2), max_speed, friction, gravity)
        self._own_loop = False  # True while the motor's own loop moves the joint
        self._ramped = 0.0  # goal velocity after the profile, rad/s
        self.trace = MotionTrace()
        self._turns = sign * gear_ratio
        self._turn_ticks = 0  # ticks of the whole turns lost in reboots
        self._reported = 0.0  # velocity after the filter, rad/s
        self._sensed = MotionTrace()  # shaft angle, and velocity after the filter
        self._at_s: float | None = None  # None until time begins
        self.fed_s = 0.0  # time of the last instruction packet for any servo
        self._tripped = False
        self._hold()
        self._report()

    @property
    def id(self) -> int:
        """Id that it answers to."""
        return self.get(table.ID)

    @property
    def joint(self) -> float:
        """The joint's angle, rad."""
        play = 0.5 * self.backlash_rad
        return min(max(self._joint, self.q - play), self.q + play)

    @property
    def baud_rate(self) -> int:
        """Baud rate at which it receives and answers, bit/s."""
        return table.BAUD_RATES[self.get(table.BAUD_RATE)]

    def set_hardware_errors(self, errors: int) -> None:
        """Set hardware errors until a reboot; those in SHUTDOWN switch the torque off."""
        self.set(table.HARDWARE_ERROR_STATUS, self.get(table.HARDWARE_ERROR_STATUS) | errors)
        if self._is_shut_down():
            self.set(table.TORQUE_ENABLE, 0)

    def freeze(self, frozen: bool) -> None:
        """Freeze the reported position at its present value, or report the true one again."""
        if frozen and not self.frozen:
            self._report()
        self.frozen = frozen

    def advance_to(self, now_s: float) -> None:
        """Advance the joint to a time; on the way the watchdog trips if it is due."""
        if self._at_s is None:
            self._at_s = self.fed_s = now_s
            self._keep(now_s)
        self._watch_itself()
        at_s = self._at_s
        while at_s < now_s:
            until_s = now_s
            if (due_s := self._due_s()) <= at_s:
                self._trip()
            else:
                until_s = min(now_s, due_s)
            self._move(until_s - at_s, at_s)
            self._at_s = at_s = until_s
        # due exactly now: an instruction at this very time comes too late
        if self._due_s() <= at_s:
            self._trip()

    def turn_to(self, angle_rad: float) -> None:
        """Put the joint at rest at an angle, or at its end stop if that is beyond."""
        self.q = self._joint = min(max(angle_rad, self.lower), self.upper)
        self.v = self._reported = self._ramped = 0.0
        self._own_loop = False
        if self._at_s is not None:
            self._keep(self._at_s)

    def read(self, address: int, length: int) -> tuple[int, bytes]:
        """Error number and bytes of the answer to a read instruction."""
        self._report()
        if not 0 < length <= _MAX_READ_BYTES or address + length > _TABLE_END:
            return ErrorNumber.DATA_RANGE, b""
        return 0, bytes(self.bytes[address : address + length])

    def write(self, address: int, data: bytes) -> int:
        """Execute a write instruction; on an error, return its number and write nothing."""
        if error := self.refusal(address, data) or self._refusal(address, data):
            return error
        before = self.get(table.TORQUE_ENABLE), self.get(table.OPERATING_MODE)
        self.bytes[address : address + len(data)] = data
        if written_value(table.BUS_WATCHDOG, address, data) is not None:
            # the value is 0, as others are refused while tripped
            self._tripped = self._tripped and self.trip_needs_torque_cycle
        if not before[0] and self.get(table.TORQUE_ENABLE):
            self._tripped = False
        if before != (self.get(table.TORQUE_ENABLE), self.get(table.OPERATING_MODE)):
            self._hold()
        return 0

    def reboot(self) -> None:
        """Reboot: only the EEPROM and the measurements keep their values."""
        super().reboot()
        self._tripped = False
        ticks = self._ticks(self.q) - self.get(table.HOMING_OFFSET)
        self._turn_ticks += ticks - ticks % table.TICKS_PER_TURN
        self._hold()

    def _ticks(self, angle_rad: float) -> int:
        ticks = self.zero_ticks + self._turns * angle_rad / TICK_RAD
        position = table.PRESENT_POSITION
        whole = round(ticks) - self._turn_ticks + self.get(table.HOMING_OFFSET)
        return (whole - position.least) % (1 << 32) + position.least  # 32-bit wrap, after days

    def _angle(self, ticks: int) -> float:
        ticks += self._turn_ticks - self.zero_ticks - self.get(table.HOMING_OFFSET)
        return ticks * TICK_RAD / self._turns

    def _report(self) -> None:
        """Write the measurements into the control table."""
        angle_rad, velocity = self.q, self._reported
        if self.feedback_latency_s > 0.0 and self._at_s is not None:
            past = self._sensed.samples_since(self._at_s - self.feedback_latency_s)[0]
            angle_rad, velocity = past.position_rad, past.velocity_rad_s
        if self.frozen:
            velocity = 0.0
        else:
            self.set(table.PRESENT_POSITION, self._ticks(angle_rad))
        told = round(self.speed_scale * self._turns * velocity / TICK_RAD_S)
        self.set(table.PRESENT_VELOCITY, told)
        self.set(table.MOVING, int(abs(self._turns * velocity) > TICK_RAD_S))

    def _hold(self) -> None:
        """Set the goals to stay here, after a switch of torque or mode."""
        self.set(table.GOAL_VELOCITY, 0)
        self.set(table.GOAL_POSITION, self._ticks(self.q))

    def _watch_itself(self) -> None:
        """Fail if voltage or temperature are beyond their limits."""
        voltage = self.get(table.PRESENT_INPUT_VOLTAGE)
        if not self.get(table.MIN_VOLTAGE_LIMIT) <= voltage <= self.get(table.MAX_VOLTAGE_LIMIT):
            self.set_hardware_errors(VOLTAGE_ERROR)
        if self.get(table.PRESENT_TEMPERATURE) > self.get(table.TEMPERATURE_LIMIT):
            self.set_hardware_errors(HEAT_ERROR)

    def _is_shut_down(self) -> bool:
        return bool(self.get(table.HARDWARE_ERROR_STATUS) & self.get(table.SHUTDOWN))

    def _due_s(self) -> float:
        """Time at which the watchdog trips unless a packet arrives, s; inf if it is off."""
        period = self.get(table.BUS_WATCHDOG)
        if period <= 0 or not self.get(table.TORQUE_ENABLE):
            return inf
        return self.fed_s + table.WATCHDOG_S * period

    def _trip(self) -> None:
        self._hold()
        self.set(table.BUS_WATCHDOG, table.WATCHDOG_TRIPPED)
        self._tripped = True
        self.watchdog_trips += 1

    def _command(self) -> float:
        """The joint's commanded velocity, rad/s."""
        if self._tripped or not self.get(table.TORQUE_ENABLE):
            return 0.0
        side = self.speed_gain * self.goal_scale
        if self.get(table.OPERATING_MODE) == table.VELOCITY_MODE:
            return side * self.get(table.GOAL_VELOCITY) * TICK_RAD_S / self._turns
        limit = self.get(table.VELOCITY_LIMIT) * TICK_RAD_S / abs(self._turns)
        wanted = POSITION_GAIN * (self._angle(self.get(table.GOAL_POSITION)) - self.q)
        return side * min(max(wanted, -limit), limit)

    def _move(self, time_s: float, at_s: float) -> None:
        """Move towards the goals for a time without packets."""
        end_s = at_s + time_s
        most_s = _MOTOR_STEP_S if self._needs_own_loop() else _MAX_STEP_S
        step_s = min(most_s, time_s)
        while time_s > 0.0:
            before = self.q, self.v, self._reported
            self._step(min(step_s, time_s))
            time_s -= step_s
            self._keep(end_s - max(time_s, 0.0))
            now = self.q, self.v, self._reported
            change = [abs(new - old) for new, old in zip(now, before, strict=True)]
            if max(change) < _STEADY_CHANGE and not (self._own_loop and self._ramped):
                break
            # at a steady velocity one step is enough, up to the end stop
            step_s = most_s
            if self._own_loop:
                continue
            if max(change[1:]) < _STEADY_CHANGE and abs(self._command() - self.v) < _STEADY_CHANGE:
                stop = self.upper if self.v > 0.0 else self.lower
                step_s = max(_MAX_STEP_S, (stop - self.q) / self.v)
        if time_s > 0.0:
            self._keep(end_s)

    def _needs_own_loop(self) -> bool:
        motor = self._motor
        return bool(
            motor.friction or motor.gravity or self.blind or self.inverted
            or self.get(table.GOAL_PWM) != table.FULL_PWM
        )  # fmt: skip

    def _keep(self, time_s: float) -> None:
        self.trace.add(time_s, self.q, self.v)
        if self.feedback_latency_s > 0.0:
            self._sensed.add(time_s, self.q, self._reported)

    def _step(self, step_s: float) -> None:
        command = self._command()
        profile = self.get(table.PROFILE_ACCELERATION)
        if profile and not self._tripped:
            change = profile * _PROFILE_UNIT_RAD_S2 * step_s / abs(self._turns)
            command = min(max(command, self._ramped - change), self._ramped + change)
        self._ramped = command
        if self.stuck:
            self.v = 0.0
        elif self._needs_own_loop():
            if not self._own_loop:
                self._own_loop = True
                self._motor.reset(self.v)
            on = self.get(table.TORQUE_ENABLE)
            self.q, self.v = self._motor.step(
                self.q, self.v, command if on else None, step_s, blind=self.blind,
                inverted=self.inverted, duty=abs(self.get(table.GOAL_PWM)) / table.FULL_PWM,
            )  # fmt: skip
        else:
            self._own_loop = False
            decay = exp(-step_s / self.lag_s)
            self.q, self.v = _follow(
                self.q, self.v, command, self.lag_s, self.acceleration, step_s, decay
            )
        if not self.lower <= self.q <= self.upper:
            self.q, self.v = min(max(self.q, self.lower), self.upper), 0.0
        self._joint = self.joint
        kept = exp(-step_s / self.speed_filter_s) if self.speed_filter_s > 0.0 else 0.0
        self._reported = self.v + kept * (self._reported - self.v)

    def _refusal(self, address: int, data: bytes) -> int:
        """Error number of writing these bytes in the servo's present state; 0 for none."""
        if written_value(table.TORQUE_ENABLE, address, data) and self._is_shut_down():
            # by the manual only a reboot ends a shutdown; the error number here is a guess
            return ErrorNumber.RESULT_FAIL
        goals = any(written_value(goal, address, data) is not None for goal in _GOAL_REGISTERS)
        if self._tripped and (goals or written_value(table.BUS_WATCHDOG, address, data)):
            # by the manual a tripped watchdog answers goals with a range error
            return ErrorNumber.DATA_RANGE
        return 0
