"""Between the angles of a head's actuators and the ticks of its servos.

What is sent is limited to the speeds of head and servos, and to the speed v from which a joint
still stops before its limit,

    v (lag + period) + v^2 / (2 a) = room,

a half of its greatest acceleration; while it slows down, what it coasts by at the speed u that it
still has counts too, v period + u lag + u^2 / (2 a) <= room. Servos take velocities in steps of
0.229 rev/min; what a period rounds off is carried over to the next.
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
_MOST_RAD_S2: Final = 1e3
"""Stands for an acceleration without a limit."""
_BRAKING: Final = 0.5
"""Share of a joint's greatest acceleration that braking before a limit counts on."""
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
        for servo in servos:
            self.lower[servo.slot], self.upper[servo.slot] = servo.lower_rad, servo.upper_rad
            self.there[servo.slot] = True
        timing = head.timing
        self._period_s = timing.period_s
        self._lag_s = timing.lag_s * head.actuation.lag_ratio + timing.command_latency_s
        self._brake = _BRAKING * np.clip(head.actuation.acceleration, 1e-3, _MOST_RAD_S2)

    @property
    def known(self) -> bool:
        """Whether each servo has told its angle."""
        return not np.isnan(self._measured_s[self.there]).any()

    def forget(self) -> None:
        """Know no angles: nobody has looked at the servos for a time."""
        self._measured_s[:] = np.nan

    def take(self, answers: dict[int, bytes], measured_s: float) -> None:
        """Take the answers to a question for speed and angle; who did not answer goes on.

        Args:
            answers: eight bytes by id, present velocity and present position.
            measured_s: when they were measured, s.
        """
        for servo in self._servos:
            slot, data = servo.slot, answers.get(servo.id)
            if data is None:
                # nan before the first answer; a longer silence is refused, or nobody has asked
                ahead_s = min(measured_s - self._measured_s[slot], SILENT_S)
                if np.isnan(ahead_s):
                    continue
                self.angles[slot] += self.speeds[slot] * ahead_s
            else:
                speed = int.from_bytes(data[:4], "little", signed=True)
                ticks = int.from_bytes(data[4:], "little", signed=True)
                turns = servo.sign / servo.gear_ratio
                self.speeds[slot] = turns * speed * table.TICK_RAD_S
                self.angles[slot] = self._angle(servo, ticks)
            self._measured_s[slot] = measured_s

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
        limit = self._head.actuation.velocity
        wanted = np.clip(velocity, -limit, limit)
        up = self._stopping(self.upper - self.angles, self.speeds)
        down = self._stopping(self.angles - self.lower, -self.speeds)
        wanted = np.clip(wanted, -down, up)
        out, sent = {}, np.zeros(7)
        for servo in self._servos:
            slot, per_tick = servo.slot, servo.sign / servo.gear_ratio * table.TICK_RAD_S
            exact = wanted[slot] / per_tick
            most = self.limit_ticks.get(servo.id, 0)
            ticks = int(np.clip(np.rint(exact + self.carried[slot]), -most, most))
            still = abs(exact) < _STILL_TICKS
            self.carried[slot] = (
                0.0 if still else np.clip(exact + self.carried[slot] - ticks, -1, 1)
            )
            out[servo.id] = 0 if still else ticks
            sent[slot] = out[servo.id] * per_tick
        return out, sent

    def _stopping(self, room: FloatArray, speed: FloatArray) -> FloatArray:
        """The speed from which joints stop within some room, see the module's description."""
        late = self._brake * (self._lag_s + self._period_s)
        steady = np.sqrt(late**2 + 2.0 * self._brake * np.maximum(room, 0.0)) - late
        # a joint is still faster than its last commands, and coasts on by this
        fast = np.maximum(speed, 0.0)
        coasts = fast * self._lag_s + fast**2 / (2.0 * self._brake)
        return np.clip((room - coasts) / self._period_s, 0.0, steady)
