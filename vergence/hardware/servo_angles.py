"""Between the angles of a head's actuators and the ticks of its servos.

Servos take velocities in steps of 0.229 rev/min; what a period rounds off is carried over to the
next. An answer is believed if a joint can have come so far, and turn so fast, since the last one:
of damaged packets, one in 65,536 has a checksum that fits.
"""

from typing import Final

import numpy as np

from vergence.hardware.config import ServoConfig
from vergence.hardware.dynamixel import control_table as table
from vergence.models.head import HeadModel
from vergence.models.joints import EYES, NECK
from vergence.models.parts import FloatArray

SILENT_S: Final = 0.1
"""Time after which a servo that does not answer counts as gone, s."""
_FASTER: Final = 2.0
"""Speed that is believed, by the head's greatest."""
_JUMP_RAD: Final = 0.1
"""Way beyond what that speed makes of the time, that is believed, rad: a servo that is pushed."""
_STILL_TICKS: Final = 0.05
"""Commands below so many ticks are none: what was carried over is dropped, and the joint rests."""


class ServoAngles:
    """Between angles of a head's actuators and ticks of its servos.

    Attributes:
        angles: (7,) of the neck's joints and the actuators of the eyes, rad.
        speeds: (7,) rad/s.
        there: (7,) whether there is a servo.
        lower: (7,) least angles, rad.
        upper: (7,) greatest angles, rad.
        carried: (7,) what the last commands have left over, ticks.
        limit_ticks: greatest speeds by id, ticks.
    """

    def __init__(self, servos: tuple[ServoConfig, ...], head: HeadModel) -> None:
        self._servos = servos
        self._head = head
        self.ids = [servo.id for servo in servos]
        self.angles, self.speeds = np.zeros(7), np.zeros(7)
        self.lower, self.upper = np.zeros(7), np.zeros(7)
        self.there = np.zeros(7, dtype=np.bool_)
        self.carried = np.zeros(7)
        self.limit_ticks: dict[int, int] = {}
        self._measured_s = np.full(7, np.nan)
        self._believed_s = np.full(7, np.nan)
        for servo in servos:
            self.lower[servo.slot], self.upper[servo.slot] = servo.lower_rad, servo.upper_rad
            self.there[servo.slot] = True
        self._fastest = _FASTER * head.actuation.velocity

    def ages(self, now_s: float) -> FloatArray:
        """(7,) time since each servo has told its angle, s; 0 where there is none."""
        return np.where(self.there, now_s - self._believed_s, 0.0)

    @property
    def known(self) -> bool:
        """Whether each servo has told its angle."""
        return not np.isnan(self._believed_s[self.there]).any()

    def take(self, answers: dict[int, bytes], measured_s: float) -> set[int]:
        """Take the answers to a question for speed and angle; who did not answer goes on.

        Args:
            answers: eight bytes by id, present velocity and present position.
            measured_s: when they were measured, s.

        Returns:
            The ids of those whose answers are believed.
        """
        believed = set()
        for servo in self._servos:
            slot, data = servo.slot, answers.get(servo.id)
            since_s = measured_s - self._believed_s[slot]  # nan before the first answer
            told = None if data is None else self._told(servo, data)
            if told is not None and self._is_possible(slot, *told, since_s):
                self.angles[slot], self.speeds[slot] = told
                self._believed_s[slot] = measured_s
                believed.add(servo.id)
            elif not np.isnan(since_s):
                # a longer silence is refused, or nobody has asked
                ahead_s = min(measured_s - self._measured_s[slot], SILENT_S)
                self.angles[slot] += self.speeds[slot] * ahead_s
            self._measured_s[slot] = measured_s
        return believed

    def _told(self, servo: ServoConfig, data: bytes) -> tuple[float, float]:
        """Angle and speed of the joint by a servo's answer."""
        speed = int.from_bytes(data[:4], "little", signed=True)
        ticks = int.from_bytes(data[4:], "little", signed=True)
        turns = servo.sign / servo.gear_ratio
        return self._angle(servo, ticks), turns * speed * table.TICK_RAD_S

    def _is_possible(self, slot: int, angle: float, speed: float, since_s: float) -> bool:
        fastest = float(self._fastest[slot])
        if np.isnan(since_s):
            return True
        way = _JUMP_RAD + fastest * since_s
        return abs(speed) <= fastest + 1.0 and abs(angle - self.angles[slot]) <= way

    @staticmethod
    def _angle(servo: ServoConfig, ticks: int) -> float:
        """The angle at a position, on the turn of the servo that is nearest to its range."""
        angle = (ticks - servo.zero_ticks) / servo.ticks_per_rad
        middle = 0.5 * (servo.lower_rad + servo.upper_rad)
        turn = table.TICKS_PER_TURN / abs(servo.ticks_per_rad)
        return angle - turn * round((angle - middle) / turn)

    def joints(self) -> tuple[FloatArray, FloatArray]:
        """(7,) angles and (7,) speeds of the joints, rad and rad/s."""
        actuation = self._head.actuation
        q, v = actuation.joints_of(self.angles), self.speeds.copy()
        if not actuation.direct:
            v[EYES] = actuation.to_joints @ self.speeds[EYES]
        rest = self._head.rest()
        q[NECK] = np.where(self.there[NECK], q[NECK], rest[NECK])
        return q, v

    def ticks(self, velocity: FloatArray) -> tuple[dict[int, int], FloatArray]:
        """What to send for velocities, and the velocities that it stands for.

        Args:
            velocity: (7,) rad/s.

        Returns:
            Ticks by id, and (7,) rad/s.
        """
        out, sent = {}, np.zeros(7)
        for servo in self._servos:
            slot, per_tick = servo.slot, servo.sign / servo.gear_ratio * table.TICK_RAD_S
            exact = velocity[slot] / per_tick
            most = self.limit_ticks.get(servo.id, 0)
            ticks = int(np.clip(np.rint(exact + self.carried[slot]), -most, most))
            still = abs(exact) < _STILL_TICKS
            self.carried[slot] = (
                0.0 if still else np.clip(exact + self.carried[slot] - ticks, -1, 1)
            )
            out[servo.id] = 0 if still else ticks
            sent[slot] = out[servo.id] * per_tick
        return out, sent
