"""An emulated Dynamixel X-series servo: a control table, and the joint that it drives.

Nothing here reads a clock or does I/O.

Emulated are velocity and position modes, the locks and ranges of registers, the bus watchdog, and
the errors of voltage, temperature and load with the shutdown that SHUTDOWN configures. An error
lasts until a reboot; until then torque cannot be switched on. A reboot takes no time; after it the
position is reported within one turn again, as the encoder is absolute within one turn only.

Not emulated, and refused with an error: other modes and the reverse bit of DRIVE_MODE. Gain
registers have no effect. A servo without friction and gravity moves by the package's joint law, and
comes to rest with its lag when it loses torque; friction, gravity, a blind encoder or an inverted
motor need the motor's own loop, see `vergence.hardware.emulator.motor`.
"""

from math import exp, inf, pi
from typing import Final

from vergence.errors import ConfigurationError
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.control_table import TICK_RAD, TICK_RAD_S, Register
from vergence.hardware.dynamixel.packets import ErrorNumber
from vergence.hardware.emulator.memory import ControlTable, written_value
from vergence.hardware.emulator.motor import STEP_S, Motor
from vergence.hardware.emulator.trace import MotionTrace
from vergence.models.motion import follow_joint

POSITION_GAIN: Final = 20.0
"""Gain of the position loop, 1/s: plausible, not taken from a real servo (chosen)."""
MAX_STEP_S: Final = 0.002
"""Longest step while a joint's velocity changes, s: a tenth of a quick servo's lag (numerical)."""
VOLTAGE_ERROR: Final = 1 << 0
"""Bit of HARDWARE_ERROR_STATUS and SHUTDOWN: the input voltage is outside its limits (physical:
Dynamixel X series)."""
ENCODER_ERROR: Final = 1 << 3
"""Bit of these registers: the encoder fails (physical: as above)."""
HEAT_ERROR: Final = 1 << 2
"""Bit of these registers: the temperature is above its limit (physical: as above)."""
LOAD_ERROR: Final = 1 << 5
"""Bit of these registers: the load was too great for too long (physical: as above)."""

_PROFILE_UNIT_RAD_S2: Final = 214.577 * 2 * pi / 3600
"""Unit of PROFILE_ACCELERATION, 214.577 rev/min^2 in rad/s^2 (physical: Dynamixel X series)."""
_STIFF_RAD_S2: Final = 1e3
"""Greatest acceleration of a motor without a limit, rad/s^2 (numerical)."""
_STEADY_CHANGE: Final = 1e-12
"""Change per step below which a state counts as steady, rad and rad/s (numerical)."""
_GOAL_REGISTERS: Final = (table.GOAL_PWM, table.GOAL_VELOCITY, table.GOAL_POSITION)

_follow = getattr(follow_joint, "py_func", follow_joint)


class EmulatedServo:
    """One servo and the joint that it moves.

    Angles are the joint's: the servo's position in ticks is
    `zero_ticks + sign gear_ratio angle / TICK_RAD + HOMING_OFFSET`.

    Args:
        id: id on the line.
        lag_s: time constant of the joint's velocity, s.
        acceleration: greatest acceleration of the joint, rad/s^2.
        lower: lower end stop of the joint, rad.
        upper: upper end stop, rad.
        sign: 1, or -1 if the servo turns against the joint.
        zero_ticks: the servo's position where the joint's angle is 0.
        gear_ratio: turns of the servo in one of the joint.
        speed_filter_s: time constant of the low-pass filter on PRESENT_VELOCITY, s; 0 for none.
        speed_gain: steady-state speed of the joint per commanded speed.
        backlash_rad: backlash between the servo's shaft, where its encoder is, and the joint, rad.
        feedback_latency_s: age of the position and velocity that it reports, s.
        max_speed: greatest speed of the joint, rad/s, for the motor's own loop.
        friction: Coulomb friction, as a fraction of the greatest torque.
        gravity: torque of gravity at angle 0, as a fraction of the greatest torque.
        position_rad: the joint's angle at the start.

    Attributes:
        memory: the control table.
        q: the shaft's angle, rad.
        v: the shaft's velocity, rad/s.
        trace: the past motion of the shaft.
        watchdog_trips: number of times that the watchdog has stopped it.
        silent: True if it answers and obeys nothing, as with its plug pulled out.
        stuck: True if the joint does not move.
        frozen: True if the encoder reports a fixed position and no velocity while the joint moves.
        blind: True if the inner loop sees no motion either; needs `frozen` too.
        inverted: True if the motor turns against its drive, so that the inner loop runs away.
        goal_scale: the joint's speed by its goal; -1 turns against it. The encoder reports this.
        speed_scale: reported by true speed, for a servo with other units.
        eeprom_write_s: time that it needs for writing to its EEPROM before it answers, s.
        trip_needs_torque_cycle: True if a tripped watchdog locks the goals until torque has been
            switched off and on, as some firmware has it.

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
        speed_gain: float = 1.0,
        backlash_rad: float = 0.0,
        feedback_latency_s: float = 0.0,
        max_speed: float = 6.0,
        friction: float = 0.0,
        gravity: float = 0.0,
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
        self.speed_gain, self.backlash_rad = speed_gain, backlash_rad
        self.feedback_latency_s = feedback_latency_s
        self.q = self._joint = position_rad
        self.v = 0.0
        self.watchdog_trips, self.silent = 0, False
        self.stuck = self.frozen = self.blind = self.inverted = False
        self.goal_scale = self.speed_scale = 1.0
        self._motor = Motor(lag_s, min(acceleration, _STIFF_RAD_S2), max_speed, friction, gravity)
        self._own_loop = False  # True while the motor's own loop moves the joint
        self._ramped = 0.0  # goal velocity after the profile, rad/s
        self.eeprom_write_s, self.trip_needs_torque_cycle = 0.0, False
        self.trace = MotionTrace()
        self._turns = sign * gear_ratio
        self._turn_ticks = 0  # ticks of the whole turns lost in reboots
        self._reported = 0.0  # velocity after the filter, rad/s
        self._sensed = MotionTrace()  # shaft angle, and velocity after the filter
        self._at_s: float | None = None  # None until time begins
        self._fed_s = 0.0
        self._tripped = False
        self.memory = ControlTable(id)
        self._hold()
        self._report()

    @property
    def id(self) -> int:
        """Id that it answers to."""
        return self.get(table.ID)

    @property
    def joint(self) -> float:
        """The joint's angle, which the shaft pushes at the ends of the backlash, rad."""
        play = 0.5 * self.backlash_rad
        return min(max(self._joint, self.q - play), self.q + play)

    @property
    def baud_rate(self) -> int:
        """Baud rate at which it receives and answers, bit/s."""
        return table.BAUD_RATES[self.get(table.BAUD_RATE)]

    def get(self, register: Register) -> int:
        """Value of a register."""
        return self.memory.get(register)

    def set(self, register: Register, value: int) -> None:
        """Set a register, without checks of locks and ranges."""
        self.memory.set(register, value)

    def set_hardware_errors(self, errors: int) -> None:
        """Set hardware errors, bits of HARDWARE_ERROR_STATUS, until a reboot.

        Errors whose bits SHUTDOWN has too switch the torque off.
        """
        self.set(table.HARDWARE_ERROR_STATUS, self.get(table.HARDWARE_ERROR_STATUS) | errors)
        if self._is_shut_down():
            self.set(table.TORQUE_ENABLE, 0)

    def freeze(self, frozen: bool) -> None:
        """Freeze the reported position at its present value, or report the true one again."""
        if frozen and not self.frozen:
            self._report()
        self.frozen = frozen

    def feed_watchdog(self, now_s: float) -> None:
        """Receive an instruction packet for any servo: it restarts the watchdog's time."""
        self._fed_s = now_s

    def advance_to(self, now_s: float) -> None:
        """Advance the joint to a time; on the way the watchdog trips if it is due."""
        if self._at_s is None:
            self._at_s = self._fed_s = now_s
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

    def read(self, address: int, length: int) -> tuple[int, bytes]:
        """Error number and bytes of the answer to a read instruction."""
        self._report()
        return self.memory.read(address, length)

    def write(self, address: int, data: bytes) -> int:
        """Execute a write instruction; on an error, return its number and write nothing."""
        error = self.memory.refusal(address, data) or self._refusal(address, data)
        if error:
            return error
        before = self.get(table.TORQUE_ENABLE), self.get(table.OPERATING_MODE)
        self.memory.bytes[address : address + len(data)] = data
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
        self.memory.reboot()
        self._tripped = False
        per_turn = table.TICKS_PER_TURN
        self._turn_ticks += (
            (self._ticks(self.q) - self.get(table.HOMING_OFFSET)) // per_turn * per_turn
        )
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
        told = self.speed_scale * self._turns * velocity / TICK_RAD_S
        self.set(table.PRESENT_VELOCITY, round(told))
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
        return self._fed_s + table.WATCHDOG_S * period

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
        most_s = STEP_S if self._needs_own_loop() else MAX_STEP_S
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
                step_s = max(MAX_STEP_S, (stop - self.q) / self.v)
        if time_s > 0.0:
            self._keep(end_s)

    def _needs_own_loop(self) -> bool:
        motor = self._motor
        return bool(
            motor.friction or motor.gravity or self.blind or self.inverted
            or self.get(table.GOAL_PWM) != table.FULL_PWM
        )  # fmt: skip

    def _profiled(self, command: float, step_s: float) -> float:
        """Velocity goal after the ramp of PROFILE_ACCELERATION."""
        profile = self.get(table.PROFILE_ACCELERATION)
        if profile and not self._tripped:
            change = profile * _PROFILE_UNIT_RAD_S2 * step_s / abs(self._turns)
            command = min(max(command, self._ramped - change), self._ramped + change)
        self._ramped = command
        return command

    def _keep(self, time_s: float) -> None:
        self.trace.add(time_s, self.q, self.v)
        if self.feedback_latency_s > 0.0:
            self._sensed.add(time_s, self.q, self._reported)

    def _step(self, step_s: float) -> None:
        command = self._profiled(self._command(), step_s)
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
        if self._tripped:
            goals = any(written_value(goal, address, data) is not None for goal in _GOAL_REGISTERS)
            if goals or written_value(table.BUS_WATCHDOG, address, data):
                # by the manual a tripped watchdog answers goals with a range error
                return ErrorNumber.DATA_RANGE
        return 0
