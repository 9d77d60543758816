"""Servos that are only read: nothing is written to them, and nothing moves."""

import time
from collections.abc import Callable

import numpy as np

from vergence.envs.reading import BoolArray
from vergence.hardware.config import ServoConfig
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.repeated import read_register
from vergence.hardware.servos import HeadServos
from vergence.models.parts import FloatArray


class ReadOnlyServos(HeadServos):
    """The servos of one head, left as they are; for the arguments and errors see `HeadServos`."""

    def _stand_still(self) -> None:
        pass

    def _set_up(self, servo: ServoConfig) -> None:
        self.angles.limit_ticks[servo.id] = read_register(self._bus, servo.id, table.VELOCITY_LIMIT)

    def switch_on(self) -> None:
        """Leave the torque as it is."""

    def send(self, velocity: FloatArray) -> FloatArray:
        """Send nothing; return (7,) zeros."""
        return np.zeros(7)

    def watchdog_trip_pause_s(self) -> float:
        """Return 0, as no watchdog is armed."""
        return 0.0

    def release_torque(self, joints: BoolArray) -> None:
        """Leave the torque as it is."""

    def close(self, sleep: Callable[[float], None] = time.sleep) -> None:
        """Release the line."""
        self._bus.close()
