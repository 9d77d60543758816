"""The world of an emulated head: its servos on their line, their faults, and the target before it.

Joints move by the package's joint law, computed on demand and exactly: each request first advances
them to the present, in pieces between the instants at which faults begin and end.
"""

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import zip_longest
from math import ceil
from operator import and_
from typing import Any, Final, NamedTuple

import numpy as np

from vergence.envs.targets.motion import (
    MOTION,
    is_shown,
    motion_rows,
    target_position,
)
from vergence.errors import ConfigurationError
from vergence.hardware.config import actuator_slots
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.packets import (
    ALERT,
    BROADCAST,
    ErrorNumber,
    Instruction,
    Packet,
    status_packet,
)
from vergence.hardware.emulator.faults import ActiveFaults, Fault
from vergence.hardware.emulator.servo import ENCODER_ERROR, EmulatedServo, rest_start_and_top_speed
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.models.ruler import ServoModel, find_servo_model

_RETURN_DELAY_UNIT_S: Final = 2e-6
"""Unit of RETURN_DELAY_TIME, s (physical: Dynamixel X series)."""


class TimedAnswer(NamedTuple):
    """A status packet that a servo sends."""

    id: int
    return_delay_s: float
    """Its RETURN_DELAY_TIME and the time that it writes to its EEPROM, from the end of the request
    or of the answer before it, s."""
    data: bytes


class ServoLine:
    """Servos that share a line.

    In a sync read the servos after a silent one answer all the same.

    Args:
        servos: the servos.
    """

    def __init__(self, servos: Iterable[EmulatedServo]) -> None:
        self.servos = tuple(servos)

    @property
    def watchdog_trips(self) -> int:
        """Number of times that watchdogs have stopped servos."""
        return sum(servo.watchdog_trips for servo in self.servos)

    def advance_to(self, now_s: float) -> None:
        """Advance all joints to a time, s; an earlier time than before changes nothing."""
        for servo in self.servos:
            servo.advance_to(now_s)

    def positions(self) -> FloatArray:
        """True angles of the joints, rad, shape (n,)."""
        return np.array([servo.q for servo in self.servos])

    def velocities(self) -> FloatArray:
        """True velocities of the joints, rad/s, shape (n,)."""
        return np.array([servo.v for servo in self.servos])

    def answer(
        self, packet: Packet, now_s: float, baud_rate: int | None = None
    ) -> list[TimedAnswer]:
        """Status packets that answer a packet, in their order.

        Args:
            packet: any packet from the line.
            now_s: time of its arrival, on the clock of `advance_to`, s.
            baud_rate: baud rate at which it was sent; servos with another rate do not receive it.
                None for each servo's own.
        """
        self.advance_to(now_s)
        if packet.instruction == Instruction.STATUS:
            return []
        present = [
            servo
            for servo in self.servos
            if not servo.silent and baud_rate in (None, servo.baud_rate)
        ]
        for servo in present:
            servo.feed_watchdog(now_s)
        if packet.instruction == Instruction.SYNC_READ:
            return _overlapping(_sync_read(present, packet))
        if packet.instruction == Instruction.SYNC_WRITE:
            _sync_write(present, packet)
            return []
        answers = []
        for servo in present:
            if packet.id in (servo.id, BROADCAST):
                answers.append(_execute(servo, packet))
            elif packet.instruction == Instruction.WRITE and _obeys(servo, packet.id):
                _execute(servo, packet)
        return _overlapping(answer for answer in answers if answer is not None)


def _obeys(servo: EmulatedServo, id: int) -> bool:
    """True if a servo carries out what is written to an id."""
    return id == servo.id or (id == servo.get(table.SECONDARY_ID) and id < table.NO_SECONDARY_ID)


def _overlapping(answers: Iterable[TimedAnswer]) -> list[TimedAnswer]:
    """Answers as they arrive, in the order of their ids' first ones."""
    order: dict[int, list[TimedAnswer]] = {}
    for answer in answers:
        order.setdefault(answer.id, []).append(answer)
    return [
        same[0]
        if len(same) == 1
        else TimedAnswer(
            id, max(one.return_delay_s for one in same), _anded(one.data for one in same)
        )
        for id, same in order.items()
    ]


def _anded(packets: Iterable[bytes]) -> bytes:
    """Bytes of packets that are sent at once: after its end a packet leaves the line at 1."""
    columns = zip_longest(*packets, fillvalue=0xFF)
    return bytes(reduce(and_, column) for column in columns)


def _execute(servo: EmulatedServo, packet: Packet) -> TimedAnswer | None:
    """Execute an instruction on one servo; answer it if the servo's return level asks for it."""
    level, id = servo.get(table.STATUS_RETURN_LEVEL), servo.id
    params, data, error, busy_s = packet.params, b"", 0, 0.0
    least_level = 2
    if packet.instruction == Instruction.PING:
        least_level = 0
        data = bytes(servo.memory.bytes[0:2]) + bytes(servo.memory.bytes[6:7])
    elif packet.instruction == Instruction.READ:
        least_level = 1
        if len(params) == 4:
            error, data = servo.read(_number(params, 0), _number(params, 2))
        else:
            error = ErrorNumber.DATA_LENGTH
    elif packet.instruction == Instruction.WRITE:
        short = len(params) < 2
        error = ErrorNumber.DATA_LENGTH if short else servo.write(_number(params, 0), params[2:])
        if not short and not error and _number(params, 0) < table.EEPROM_END:
            busy_s = servo.eeprom_write_s
    elif packet.instruction == Instruction.REBOOT:
        servo.reboot()
    else:
        error = ErrorNumber.INSTRUCTION
    quiet = level < least_level or (packet.id == BROADCAST and least_level > 0)
    return None if quiet else _status(servo, id, data, error, busy_s)


def _sync_read(servos: list[EmulatedServo], packet: Packet) -> Iterator[TimedAnswer]:
    if packet.id != BROADCAST or len(packet.params) < 4:
        return
    address, length = _number(packet.params, 0), _number(packet.params, 2)
    for id in packet.params[4:]:
        for servo in servos:
            if servo.id == id and servo.get(table.STATUS_RETURN_LEVEL) >= 1:
                error, data = servo.read(address, length)
                yield _status(servo, id, data, error)


def _sync_write(servos: list[EmulatedServo], packet: Packet) -> None:
    if packet.id != BROADCAST or len(packet.params) < 4:
        return
    address, length = _number(packet.params, 0), _number(packet.params, 2)
    for at in range(4, len(packet.params) - length, length + 1):
        for servo in servos:
            if _obeys(servo, packet.params[at]):
                servo.write(address, packet.params[at + 1 : at + 1 + length])


def _status(
    servo: EmulatedServo, id: int, data: bytes, error: int, busy_s: float = 0.0
) -> TimedAnswer:
    alert = ALERT if servo.get(table.HARDWARE_ERROR_STATUS) else 0
    delay_s = _RETURN_DELAY_UNIT_S * servo.get(table.RETURN_DELAY_TIME)
    return TimedAnswer(id, busy_s + delay_s, status_packet(id, data, error | alert))


def _number(params: bytes, at: int) -> int:
    return int.from_bytes(params[at : at + 2], "little")


_SHORT_ANSWER_BYTES: Final = 6
"""Bytes left of an answer that is cut short: header, id, and half of the length (chosen)."""
_CRC_FLIPPED: Final = 0x01
"""Bits of the checksum's last byte that are flipped (chosen)."""


def apply_line_faults(
    answers: Sequence[TimedAnswer], faults: Iterable[Fault], rng: np.random.Generator
) -> list[tuple[float, bytes]]:
    """Apply the faults of the line to the answers to one request.

    Args:
        answers: the answers, in their order.
        faults: active faults of the line; each is drawn separately for every answer of its servos,
            in this order.
        rng: random generator of the draws.

    Returns:
        Pairs of the delay beyond the faultless time, s, and the bytes, earliest first; bytes with
        the same delay are joined.
    """
    sent: dict[float, bytes] = {}
    faults = list(faults)
    for answer in answers:
        late_s, data = 0.0, answer.data
        for fault in faults:
            if answer.id not in fault.ids or rng.random() >= fault.probability:
                continue
            if fault.what == "late":
                late_s += fault.value
            else:
                data = _damaged(fault.what, data)
        if data:
            sent[late_s] = sent.get(late_s, b"") + data
    return sorted(sent.items())


def _damaged(fault_name: str, data: bytes) -> bytes:
    if fault_name == "bad-crc":
        return data[:-1] + bytes(byte ^ _CRC_FLIPPED for byte in data[-1:])
    if fault_name == "short":
        return data[:_SHORT_ANSWER_BYTES]
    return data + data if fault_name == "doubled" else b""


_DIFFERENCE_S: Final = 1e-4
"""Step of the central difference for the target's velocity, s (numerical)."""
_LEVER_STEP_RAD: Final = 1e-4
"""Step of the difference that finds a joint's axis, rad (numerical)."""
_SIX_VOLTS: Final = 6.0
"""Supply below which a servo's limits are those of the XL330, 3.5 to 7 V (physical: Dynamixel X
series)."""
_FIRMWARE: Final = 52
"""Firmware of emulated models (chosen: the first without reports of a failing watchdog)."""
_BAUD_RATE: Final = 1_000_000
"""Baud rate that the servos are set to, bit/s (chosen)."""


@dataclass(frozen=True, kw_only=True)
class MotorOptions:
    """Dynamics and encoders of the servos of an emulated head, and the adapter of their line."""

    servo: str | None = None
    """Servo model, see `vergence.models.ruler`; None for an XL430-W250 as the head has it.
    """
    speed_filter_s: float = 0.0
    """Time constant of the low-pass filter on reported speeds, s."""
    lag_s: float | None = None
    """Time constant of their response, s; None for the head's."""
    acceleration_rad_s2: float | None = None
    """Their greatest acceleration, rad/s^2; None for the model's or the head's."""
    speed_gain: float = 1.0
    """Steady-state speed per commanded speed."""
    command_latency_s: float = 0.0
    """Latency from a command's arrival to their response, s."""
    backlash_rad: float = 0.0
    """Backlash between encoders and joints, rad."""
    feedback_latency_s: float = 0.0
    """Age of the angles and speeds that servos report, s."""
    answer_latency_s: float = 0.0
    """Delay of every answer by the adapter, s."""
    friction: float = 0.0
    """Coulomb friction, as a fraction of the greatest torque."""
    gravity: float = 0.0
    """Greatest torque of gravity about a horizontal axis, as a fraction of the greatest torque."""


def _make_model(servo: EmulatedServo, model: ServoModel) -> None:
    """Set the registers in which a model differs from an XL430-W250."""
    number = table.model_number(model.name)
    servo.set(table.MODEL_NUMBER, number)
    servo.set(table.FIRMWARE_VERSION, _FIRMWARE)
    servo.set(table.VELOCITY_LIMIT, ceil(model.speed_rad_s / table.TICK_RAD_S))
    i_gain, p_gain = table.factory_velocity_gains(number)[0]
    servo.set(table.VELOCITY_I_GAIN, i_gain)
    servo.set(table.VELOCITY_P_GAIN, p_gain)
    servo.set(table.PRESENT_INPUT_VOLTAGE, round(10.0 * model.volts))
    if model.volts < _SIX_VOLTS:
        servo.set(table.MIN_VOLTAGE_LIMIT, 35)
        servo.set(table.MAX_VOLTAGE_LIMIT, 70)


def _lever(head: HeadModel, slot: int) -> float:
    """Horizontal part of the axis about which an actuator turns a camera at rest."""
    rest = head.rest()
    motors = head.actuation.actuators_of(rest)
    motors[slot] += _LEVER_STEP_RAD
    turned = head.actuation.joints_of(motors)
    before, after = (head.base_pose(q) @ head.camera_poses(q) for q in (rest, turned))
    turns = after[:, :3, :3] @ np.swapaxes(before[:, :3, :3], -1, -2)
    axis = np.stack([turns[:, 2, 1], turns[:, 0, 2], turns[:, 1, 0]], axis=-1) / _LEVER_STEP_RAD
    # y of the frame 0 points down
    return float(np.hypot(axis[:, 0], axis[:, 2]).max())


class World:
    """A head's joints and its target, in real time.

    Its servos are set up for a controller: 1 Mb/s, no return delay, and a shutdown that a broken
    encoder brings about too.

    Args:
        head: the head that really moves.
        point: (3,) target position until another one is placed, in N, m.
        motors: dynamics and encoders of the servos, and the adapter of their line.
        seed: random seed of the faults of answers.
        T_0_T: (4, 4) pose of a fixed board in place of a target, m; None for a target.
    """

    def __init__(
        self,
        head: HeadModel,
        point: FloatArray,
        motors: MotorOptions | None = None,
        seed: int = 0,
        T_0_T: FloatArray | None = None,
    ) -> None:
        motors = motors or MotorOptions()
        self.head = head
        self._slots = actuator_slots(head)
        actuation, timing = head.actuation, head.timing
        lag_s = timing.lag_s if motors.lag_s is None else motors.lag_s
        acceleration = actuation.acceleration
        model = None if motors.servo is None else find_servo_model(motors.servo)
        if motors.acceleration_rad_s2 is not None:
            acceleration = np.full(7, motors.acceleration_rad_s2)
        elif model is not None:
            acceleration = np.full(7, model.acceleration_rad_s2)
        start = actuation.actuators_of(head.rest())
        self.servos = {
            name: EmulatedServo(
                ident,
                lower=float(actuation.lower[slot]),
                upper=float(actuation.upper[slot]),
                lag_s=float(lag_s * actuation.lag_ratio[slot]),
                acceleration=float(acceleration[slot]),
                position_rad=float(start[slot]),
                speed_filter_s=motors.speed_filter_s,
                speed_gain=motors.speed_gain,
                backlash_rad=motors.backlash_rad,
                feedback_latency_s=motors.feedback_latency_s,
                max_speed=model.speed_rad_s if model else float(actuation.velocity[slot]),
                friction=motors.friction,
                gravity=motors.gravity * _lever(head, slot),
            )
            for ident, (name, slot) in enumerate(self._slots.items(), 1)
        }
        for servo in self.servos.values():
            servo.set(table.BAUD_RATE, table.BAUD_RATES.index(_BAUD_RATE))
            servo.set(table.RETURN_DELAY_TIME, 0)
            servo.set(table.SHUTDOWN, servo.get(table.SHUTDOWN) | ENCODER_ERROR)
            if model is not None:
                _make_model(servo, model)
        self.ids = tuple(servo.id for servo in self.servos.values())
        self.line = ServoLine(self.servos.values())
        self.faults = ActiveFaults(self.servos.values())
        self._command_latency_s = motors.command_latency_s
        self._answer_latency_s = motors.answer_latency_s
        self._commands: deque[tuple[float, Packet]] = deque()
        self._rng = np.random.default_rng(seed)
        self._told_s = -np.inf
        self._motion = motion_rows(point, before=point)
        self._begun_s = np.inf
        self._T_0_N = head.base_pose(head.rest())
        self.T_0_T = T_0_T

    @property
    def places_targets(self) -> bool:
        """True if `show` places targets: unless there is a fixed board."""
        return self.T_0_T is None

    def place_target(self, motion: list[float]) -> None:
        """Place another target; `begin` starts its time."""
        if not self.places_targets:
            raise ConfigurationError("show: expected no target, as the board stands still")
        row = np.array([motion], dtype=np.float64)
        if row.ndim != 2 or row.shape[1] < MOTION:
            raise ConfigurationError(f"show: expected {MOTION} numbers or more, got {row.size}")
        self._motion, self._begun_s = row, np.inf
        self._T_0_N = self.head.base_pose(self._joints()[0])

    def start_target_motion(self, now_s: float) -> None:
        """Start the target's own time."""
        self._begun_s = now_s

    def advance_to(self, now_s: float) -> None:
        """Advance joints and faults to a time, not before an earlier call's, s."""
        while True:
            command_s = self._commands[0][0] if self._commands else np.inf
            due_s = min(command_s, self.faults.due_s)
            if due_s > now_s:
                break
            self.line.advance_to(due_s)
            if command_s <= due_s:
                self.line.answer(self._commands.popleft()[1], due_s)
            else:
                self.faults.advance_to(due_s)
        self.line.advance_to(now_s)

    def answer(self, packet: Packet, now_s: float, baud_rate: int) -> list[tuple[float, bytes]]:
        """Answers of the servos to a packet, with the active faults of the line.

        Args:
            packet: a packet from the line.
            now_s: time of its arrival, s.
            baud_rate: baud rate at which it was sent; servos with another rate do not receive it.

        Returns:
            Pairs of the delay after the packet, without the time on the wire, s, and the bytes.
        """
        self.advance_to(now_s)
        if packet.instruction == Instruction.SYNC_WRITE and self._command_latency_s:
            self._commands.append((now_s + self._command_latency_s, packet))
            for servo in self.line.servos:
                servo.feed_watchdog(now_s)
            return []
        answers = self.line.answer(packet, now_s, baud_rate)
        if any(servo.get(table.TORQUE_ENABLE) for servo in self.line.servos):
            self.faults.start_script(now_s)
        delay_s = self._answer_latency_s + sum(answer.return_delay_s for answer in answers)
        sent = apply_line_faults(answers, self.faults.active_on("line"), self._rng)
        return [(delay_s + late_s, data) for late_s, data in sent]

    def begin_fault(self, fault: Fault, now_s: float) -> None:
        """Begin a fault."""
        self.advance_to(now_s)
        self.faults.begin(fault, now_s)
        self.line.advance_to(now_s)

    def clear_faults(self, now_s: float) -> None:
        """End all active faults."""
        self.advance_to(now_s)
        self.faults.clear()

    def rest_report(self, since_s: float, now_s: float) -> dict[str, Any]:
        """Start of the present rest, `rested_s`, and `fastest`, see `rest_start_and_top_speed`."""
        self.advance_to(now_s)
        rested_s, fastest = rest_start_and_top_speed(
            [servo.trace for servo in self.line.servos], since_s
        )
        return {"rested_s": rested_s, "fastest": fastest}

    def motion_since_last_call(self, now_s: float) -> dict[str, Any]:
        """Motion of each servo's shaft since the last call, or all that is kept: 20 s or more.

        Returns:
            By the joint's name `times`, `positions` and `velocities`, at least every 2 ms while the
            velocity changes.
        """
        self.advance_to(now_s)
        moments = {name: one.trace.samples_since(self._told_s) for name, one in self.servos.items()}
        self._told_s = now_s
        return {
            name: dict(
                zip(("times", "positions", "velocities"), zip(*own, strict=True), strict=True)
            )
            for name, own in moments.items()
        }

    def _joints(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(7,) joint angles, (7,) motor angles of neck and actuators, and (7,) motor speeds."""
        own = np.zeros((3, 7))
        for name, servo in self.servos.items():
            own[:, self._slots[name]] = servo.joint, servo.q, servo.v
        return self.head.actuation.joints_of(own[0]), own[1], own[2]

    def state(self, now_s: float) -> dict[str, Any]:
        """Ground truth at a time.

        Args:
            now_s: time, s of the monotonic clock, not before an earlier call's.
        """
        self.advance_to(now_s)
        q, motors, v = self._joints()
        if not self.head.actuation.direct:
            v[3:] = self.head.actuation.to_joints @ v[3:]
        point, velocity, axes = self._target(q, now_s)
        return {
            "time": now_s,
            "positions": q.tolist(),
            "velocities": v.tolist(),
            "motors": motors.tolist(),
            "target": point.tolist(),
            "target_velocity": velocity.tolist(),
            "target_axes": None if axes is None else axes.tolist(),
            "pixels": self.head.project(q, point).tolist(),
            "trips": self.line.watchdog_trips,
        }

    def _target(
        self, q: FloatArray, now_s: float
    ) -> tuple[FloatArray, FloatArray, FloatArray | None]:
        """(3,) point and velocity of the target in the present N; (3, 3) axes of a fixed board."""
        T_N_0 = np.linalg.inv(self.head.base_pose(q))
        if self.T_0_T is not None:
            T_N_T = T_N_0 @ self.T_0_T
            return T_N_T[:3, 3], np.zeros(3), T_N_T[:3, :3]
        own_s = now_s - self._begun_s
        times = max(own_s, -1e9) + _DIFFERENCE_S * np.array([-0.5, 0.5])
        before, after = target_position(np.repeat(self._motion, 2, axis=0), times)
        T_N_now = T_N_0 @ self._T_0_N
        point = T_N_now[:3, :3] @ (0.5 * (before + after)) + T_N_now[:3, 3]
        velocity = T_N_now[:3, :3] @ ((after - before) / _DIFFERENCE_S)
        if not is_shown(self._motion[0], own_s):
            point = np.full(3, np.nan)
        return point, velocity, None
