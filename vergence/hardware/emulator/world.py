"""The world of an emulated head: its servos on their line, their faults, and the target before it.

Joints move by the package's joint law, computed on demand and exactly: each request first advances
them to the present, in pieces between the instants at which faults begin and end.

Servos with the same id answer at the same time. On the line a 0 overrides a 1, so what arrives is
the AND of their bytes: it stays intact if all send the same, as to a ping, and else is damaged. A
servo obeys what is written to its SECONDARY_ID, without an answer.

Not emulated, and answered with an error: registered instructions, fast and bulk reads.
"""

from collections import deque
from collections.abc import Collection, Iterable, Iterator
from functools import reduce
from itertools import zip_longest
from math import ceil, isfinite
from operator import and_
from typing import Any, Final, NamedTuple

import numpy as np

from vergence.envs.targets.motion import MOTION, is_shown, motion_rows, target_position
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
from vergence.hardware.emulator.config import EmulatorConfig
from vergence.hardware.emulator.faults import ActiveFaults, Fault
from vergence.hardware.emulator.servo import ENCODER_ERROR, EmulatedServo, rest_start_s
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.models.ruler import ServoModel, find_servo_model

_RETURN_DELAY_UNIT_S: Final = 2e-6
"""Unit of RETURN_DELAY_TIME, s (physical: Dynamixel X series)."""
_RETURN_LEVELS: Final[dict[int, int]] = {Instruction.PING: 0, Instruction.READ: 1}
"""Least STATUS_RETURN_LEVEL with which an instruction is answered, if below 2 (physical: as
above)."""


class TimedAnswer(NamedTuple):
    """A status packet that a servo sends."""

    id: int
    return_delay_s: float
    """Delay after the request or the answer before it, s."""
    data: bytes


class ServoLine:
    """Servos that share a line; in a sync read those after a silent one answer all the same."""

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
        """Answers to a packet in their order, of the servos with its baud rate; None for all."""
        self.advance_to(now_s)
        if packet.instruction == Instruction.STATUS:
            return []
        hearing = [one for one in self.servos if baud_rate in (None, one.baud_rate)]
        present = [servo for servo in hearing if not servo.silent]
        for servo in present:
            servo.fed_s = now_s
        if packet.instruction in (Instruction.SYNC_READ, Instruction.SYNC_WRITE):
            if packet.id != BROADCAST or len(packet.params) < 4:
                return []
            if packet.instruction == Instruction.SYNC_READ:
                return _overlapping(_sync_read(present, packet))
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
    """Answers as they arrive, in the order of their ids' first ones.

    Of answers that are sent at once the AND arrives: after its end one leaves the line at 1.
    """
    by_id: dict[int, list[TimedAnswer]] = {}
    for answer in answers:
        by_id.setdefault(answer.id, []).append(answer)
    arriving = []
    for id, same in by_id.items():
        columns = zip_longest(*(one.data for one in same), fillvalue=0xFF)
        data = bytes(reduce(and_, column) for column in columns)
        arriving.append(TimedAnswer(id, max(one.return_delay_s for one in same), data))
    return arriving


def _execute(servo: EmulatedServo, packet: Packet) -> TimedAnswer | None:
    """Execute an instruction on one servo; answer it if the servo's return level asks for it."""
    id, params = servo.id, packet.params  # it answers with the id that it has before a write
    least_level = _RETURN_LEVELS.get(packet.instruction, 2)
    quiet = servo.get(table.STATUS_RETURN_LEVEL) < least_level
    data, error, busy_s = b"", 0, 0.0
    match packet.instruction:
        case Instruction.PING:
            data = bytes(servo.bytes[0:2] + servo.bytes[6:7])
        case Instruction.READ if len(params) == 4:
            error, data = servo.read(_number(params, 0), _number(params, 2))
        case Instruction.WRITE if len(params) >= 2:
            error = servo.write(_number(params, 0), params[2:])
            if not error and _number(params, 0) < table.EEPROM_END:
                busy_s = servo.eeprom_write_s
        case Instruction.READ | Instruction.WRITE:
            error = ErrorNumber.DATA_LENGTH
        case Instruction.REBOOT:
            servo.reboot()
        case _:
            error = ErrorNumber.INSTRUCTION
    if quiet or (packet.id == BROADCAST and least_level > 0):
        return None
    return _status(servo, id, data, error, busy_s)


def _sync_read(servos: list[EmulatedServo], packet: Packet) -> Iterator[TimedAnswer]:
    for id in packet.params[4:]:
        for servo in servos:
            if servo.id == id and servo.get(table.STATUS_RETURN_LEVEL) >= 1:
                error, data = servo.read(_number(packet.params, 0), _number(packet.params, 2))
                yield _status(servo, id, data, error)


def _sync_write(servos: list[EmulatedServo], packet: Packet) -> None:
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
    answers: Iterable[TimedAnswer], faults: Collection[Fault], rng: np.random.Generator
) -> list[tuple[float, bytes]]:
    """Delays beyond the faultless time, s, and bytes of the answers, earliest first.

    Each fault is drawn separately for every answer of its servos, in order.
    """
    sent: dict[float, bytes] = {}
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

    `point` is the target's (3,) position until another one is placed, in N, m, `T_0_T` the (4, 4)
    pose of a fixed board in its place, m; `seed` is that of the faults of answers.
    """

    def __init__(
        self,
        head: HeadModel,
        point: FloatArray,
        config: EmulatorConfig | None = None,
        seed: int = 0,
        T_0_T: FloatArray | None = None,
    ) -> None:
        config = config or EmulatorConfig()
        self.head = head
        self._slots = actuator_slots(head)
        actuation, timing = head.actuation, head.timing
        lag_s = timing.lag_s if config.lag_s is None else config.lag_s
        model = None if config.servo is None else find_servo_model(config.servo)
        acceleration = config.acceleration_rad_s2
        if acceleration is None and model is not None:
            acceleration = model.acceleration_rad_s2
        start = actuation.actuators_of(head.rest())
        self.servos = {
            name: EmulatedServo(
                ident,
                lag_s=float(lag_s * actuation.lag_ratio[slot]),
                acceleration=float(
                    actuation.acceleration[slot] if acceleration is None else acceleration
                ),
                lower=float(actuation.lower[slot]), upper=float(actuation.upper[slot]),
                speed_filter_s=config.speed_filter_s, speed_gain=config.speed_gain,
                backlash_rad=config.backlash_rad, feedback_latency_s=config.feedback_latency_s,
                max_speed=model.speed_rad_s if model else float(actuation.velocity[slot]),
                friction=config.friction, gravity=config.gravity * _lever(head, slot),
                position_rad=float(start[slot]),
            )
            for ident, (name, slot) in enumerate(self._slots.items(), 1)
        }  # fmt: skip
        for servo in self.servos.values():
            servo.set(table.BAUD_RATE, table.BAUD_RATES.index(_BAUD_RATE))
            servo.set(table.RETURN_DELAY_TIME, 0)
            servo.set(table.SHUTDOWN, servo.get(table.SHUTDOWN) | ENCODER_ERROR)
            if model is not None:
                _make_model(servo, model)
        self.ids = tuple(servo.id for servo in self.servos.values())
        self.line = ServoLine(self.servos.values())
        self.faults = ActiveFaults(self.servos.values())
        self._command_latency_s = config.command_latency_s
        self._answer_latency_s = config.answer_latency_s
        self._commands: deque[tuple[float, Packet]] = deque()
        self._rng = np.random.default_rng(seed)
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

        Pairs of the delay after the packet, without the time on the wire, s, and the bytes. Servos
        with another baud rate do not receive it.
        """
        self.advance_to(now_s)
        if packet.instruction == Instruction.SYNC_WRITE and self._command_latency_s:
            self._commands.append((now_s + self._command_latency_s, packet))
            for servo in self.line.servos:
                servo.fed_s = now_s
            return []
        answers = self.line.answer(packet, now_s, baud_rate)
        if any(servo.get(table.TORQUE_ENABLE) for servo in self.line.servos):
            self.faults.start_script(now_s)
        delay_s = self._answer_latency_s + sum(answer.return_delay_s for answer in answers)
        sent = apply_line_faults(answers, self.faults.active_on("line"), self._rng)
        return [(delay_s + late_s, data) for late_s, data in sent]

    def turn(self, angles: dict[str, float], now_s: float) -> None:
        """Put joints at angles at once, rad by the actuator's name; see `WorldClient.turn`."""
        angles = {name: float(angle) for name, angle in angles.items()}
        if not angles.keys() <= self.servos.keys() or not all(map(isfinite, angles.values())):
            expected = f"finite angles of {', '.join(self.servos)}"
            raise ConfigurationError(f"turn: expected {expected}, got {angles}")
        self.advance_to(now_s)
        for name, angle in angles.items():
            self.servos[name].turn_to(angle)

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
        """Start of the present rest, `rested_s`, see `rest_start_s`."""
        self.advance_to(now_s)
        return {"rested_s": rest_start_s([one.trace for one in self.line.servos], since_s)}

    def _joints(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(7,) joint angles, (7,) motor angles of neck and actuators, and (7,) motor speeds."""
        own = np.zeros((3, 7))
        for name, servo in self.servos.items():
            own[:, self._slots[name]] = servo.joint, servo.q, servo.v
        return self.head.actuation.joints_of(own[0]), own[1], own[2]

    def state(self, now_s: float) -> dict[str, Any]:
        """Ground truth at a time, not before an earlier call's."""
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
