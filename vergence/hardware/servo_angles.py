"""Conversion between the angles of a head's actuators and the ticks of its servos.

Servos take velocities in units of 0.229 rev/min; the rounding error of a period is carried over to
the next. An answer is accepted only if the joint can have moved so far since the last one, and can
turn so fast: one damaged packet in 65,536 still has a matching checksum.
"""

from typing import Final

import numpy as np

from vergence.hardware.config import ServoConfig
from vergence.hardware.dynamixel import control_table as table
from vergence.models.head import HeadModel
from vergence.models.parts import EYES, NECK, FloatArray

SILENT_S: Final = 0.1
"""Time without an answer after which a servo counts as lost, s (chosen)."""
_MAX_SPEED_RATIO: Final = 2.0
"""Greatest accepted speed as a ratio to the head's greatest (chosen)."""
_EXTRA_MOTION_RAD: Final = 0.1
"""Accepted motion beyond that of this speed, rad, for a servo that is pushed (chosen)."""
_ZERO_COMMAND_TICKS: Final = 0.05
"""Commands below this count as zero, ticks: the carry-over is dropped, the joint rests (chosen)."""


class ServoAngles:
    """Converts between angles of a head's actuators and ticks of its servos.

    Attributes:
        angles: (7,) estimated angles of the neck's joints and the actuators of the eyes, rad.
        speeds: (7,) their speeds, rad/s.
        has_servo: (7,) True for slots with a servo.
        lower: (7,) least angles, rad.
        upper: (7,) greatest angles, rad.
        rounding_error: (7,) rounding error carried over to the next command, ticks.
        limit_ticks: greatest speeds by id, ticks.
    """

    def __init__(self, servos: tuple[ServoConfig, ...], head: HeadModel) -> None:
        self._servos = servos
        self._head = head
        self.ids = [servo.id for servo in servos]
        self.angles, self.speeds = np.zeros(7), np.zeros(7)
        self.lower, self.upper = np.zeros(7), np.zeros(7)
        self.has_servo = np.zeros(7, dtype=np.bool_)
        self.rounding_error = np.zeros(7)
        self.limit_ticks: dict[int, int] = {}
        self._measured_s = np.full(7, np.nan)
        self._accepted_s = np.full(7, np.nan)
        for servo in servos:
            self.lower[servo.slot], self.upper[servo.slot] = servo.lower_rad, servo.upper_rad
            self.has_servo[servo.slot] = True
        self._fastest = _MAX_SPEED_RATIO * head.actuation.velocity

    def reading_ages_s(self, now_s: float) -> FloatArray:
        """(7,) time since the last accepted answer of each servo, s; 0 in slots without one."""
        return np.where(self.has_servo, now_s - self._accepted_s, 0.0)

    @property
    def all_reported(self) -> bool:
        """True if each servo has reported its angle."""
        return not np.isnan(self._accepted_s[self.has_servo]).any()

    def update(self, answers: dict[int, bytes], measured_s: float) -> set[int]:
        """Update angles and speeds from answers; without one a joint continues at its speed.

        Args:
            answers: eight bytes by id, present velocity and present position.
            measured_s: time of the measurement, s.

        Returns:
            The ids of the servos whose answers are accepted.
        """
        accepted = set()
        for servo in self._servos:
            slot, data = servo.slot, answers.get(servo.id)
            since_s = measured_s - self._accepted_s[slot]  # nan before the first answer
            decoded = None if data is None else self._decoded(servo, data)
            if decoded is not None and self._is_plausible(slot, *decoded, since_s):
                self.angles[slot], self.speeds[slot] = decoded
                self._accepted_s[slot] = measured_s
                accepted.add(servo.id)
            elif not np.isnan(since_s):
                # after a longer silence the caller stops the head, or no read took place
                ahead_s = min(measured_s - self._measured_s[slot], SILENT_S)
                self.angles[slot] += self.speeds[slot] * ahead_s
            self._measured_s[slot] = measured_s
        return accepted

    def _decoded(self, servo: ServoConfig, data: bytes) -> tuple[float, float]:
        """Decode angle and speed of the joint from a servo's answer."""
        speed = int.from_bytes(data[:4], "little", signed=True)
        ticks = int.from_bytes(data[4:], "little", signed=True)
        turns = servo.sign / servo.gear_ratio
        return self._angle(servo, ticks), turns * speed * table.TICK_RAD_S

    def _is_plausible(self, slot: int, angle: float, speed: float, since_s: float) -> bool:
        fastest = float(self._fastest[slot])
        if np.isnan(since_s):
            return True
        way = _EXTRA_MOTION_RAD + fastest * since_s
        return abs(speed) <= fastest + 1.0 and abs(angle - self.angles[slot]) <= way

    @staticmethod
    def _angle(servo: ServoConfig, ticks: int) -> float:
        """Convert a position to the equivalent angle nearest to the middle of the joint's range."""
        angle = (ticks - servo.zero_ticks) / servo.ticks_per_rad
        middle = 0.5 * (servo.lower_rad + servo.upper_rad)
        turn = table.TICKS_PER_TURN / abs(servo.ticks_per_rad)
        return angle - turn * round((angle - middle) / turn)

    def joint_angles_and_speeds(self) -> tuple[FloatArray, FloatArray]:
        """(7,) angles and (7,) speeds of the joints, rad and rad/s."""
        actuation = self._head.actuation
        q, v = actuation.joints_of(self.angles), self.speeds.copy()
        if not actuation.direct:
            v[EYES] = actuation.to_joints @ self.speeds[EYES]
        rest = self._head.rest()
        q[NECK] = np.where(self.has_servo[NECK], q[NECK], rest[NECK])
        return q, v

    def velocities_to_ticks(self, velocity: FloatArray) -> tuple[dict[int, int], FloatArray]:
        """Quantise velocities to the units of the servos.

        Args:
            velocity: (7,) requested velocities, rad/s.

        Returns:
            Ticks to send by id, and the (7,) velocities that these are, rad/s.
        """
        out, sent = {}, np.zeros(7)
        for servo in self._servos:
            slot, per_tick = servo.slot, servo.sign / servo.gear_ratio * table.TICK_RAD_S
            exact = velocity[slot] / per_tick
            most = self.limit_ticks.get(servo.id, 0)
            ticks = int(np.clip(np.rint(exact + self.rounding_error[slot]), -most, most))
            still = abs(exact) < _ZERO_COMMAND_TICKS
            self.rounding_error[slot] = (
                0.0 if still else np.clip(exact + self.rounding_error[slot] - ticks, -1, 1)
            )
            out[servo.id] = 0 if still else ticks
            sent[slot] = out[servo.id] * per_tick
        return out, sent
