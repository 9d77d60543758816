"""One image of a board from each eye of a robot, at rest in a given posture."""

import dataclasses
from contextlib import suppress
from pathlib import Path
from typing import Final

import numpy as np

from vergence.errors import HardwareError
from vergence.hardware.approach import GoalNotReachedError, drive_to
from vergence.hardware.config import load_hardware
from vergence.hardware.pairing import SearchedImage
from vergence.hardware.plant import HardwarePlant
from vergence.models.parts import FloatArray
from vergence.recording.events import BoardView
from vergence.vision.detection import BoardDetection
from vergence.vision.targets import PlanarTarget

_MAX_SPEED_RAD_S: Final = 0.2
"""Greatest speed of the approach, rad/s (chosen)."""
_TOLERANCE_RAD: Final = 0.003
"""Tolerance of the approach, rad: a servo's least speed ends 2 mrad early (chosen)."""
_APPROACH_TIMEOUT_S: Final = 0.5
"""Longest time for the approach, s: being near is enough (chosen)."""
_REST_RAD_S: Final = 0.03
"""Joints slower than this are at rest, rad/s: above a servo's unit of 0.024 rad/s (chosen)."""
_REST_PERIODS: Final = 6
"""Control periods at rest before images count: three time constants of the servos (chosen)."""
_MAX_WAIT_FRAMES: Final = 6
"""Frames to wait for an eye that does not find the board: a search may take several (chosen)."""
_TIMEOUT_S: Final = 3.0
"""Longest time for the joints to rest and images to arrive, s (chosen)."""


class RobotLooker:
    """A real or emulated head before a board, see `vergence.recording.events.Looker`.

    Args:
        config: the file that describes the robot.
        target: the board; it replaces the target of that file.

    Attributes:
        head: the head model of that file.
        target: the board.

    Raises:
        VergenceError: something is wrong with servos, cameras or the file.
    """

    def __init__(self, config: Path, target: PlanarTarget) -> None:
        self._config = dataclasses.replace(load_hardware(config), target=target)
        self.head, self.target = self._config.head, target
        self._plant = HardwarePlant(self.head, config=self._config, view_check=False)
        self._plant.prepare()

    def look(self, q: FloatArray) -> BoardView:
        """Bring the head to rest near some joint angles and detect the board once.

        Args:
            q: (7,) joint angles, rad; clipped to the servos' limits.

        Raises:
            HardwareError: the head has been stopped, does not get there or does not come to rest,
                or gives no images.
        """
        robot = self._plant.robot
        self._plant.reset(np.array([0]), q[np.newaxis])
        try:
            pair = self._look(q)
            robot.brake()
        except HardwareError as error:
            robot.stop(str(error))
            raise
        if pair is None:
            raise HardwareError(
                "cameras: expected images of both eyes at rest, at most half a frame apart, within "
                f"{_TIMEOUT_S:g} s, got none"
            )
        left, right = (
            one.detection if isinstance(one.detection, BoardDetection) else None for one in pair
        )
        positions = [robot.history.at(one.exposed_s) for one in pair]
        return BoardView(
            time_s=0.5 * (pair[0].exposed_s + pair[1].exposed_s),
            positions=0.5 * (positions[0] + positions[1]),
            corners_px=(left and left.corners_px, right and right.corners_px),
            sigma_px=(left and left.corners_sigma_px, right and right.corners_sigma_px),
        )

    def _look(self, q: FloatArray) -> tuple[SearchedImage, SearchedImage] | None:
        """The first images at rest in which both eyes find the board, or the best of some."""
        robot, timing = self._plant.robot, self.head.timing
        with suppress(GoalNotReachedError):
            drive_to(
                self.head.actuation.actuators_of(q),
                self._config,
                robot.drive.angles,
                robot.move,
                timeout_s=_APPROACH_TIMEOUT_S,
                speed_rad_s=_MAX_SPEED_RAD_S,
                tolerance_rad=_TOLERANCE_RAD,
            )
        rested, until_s, still = 0, robot.move(np.zeros(7)) + _TIMEOUT_S, np.zeros(7)
        while rested < _REST_PERIODS:
            rested_s = robot.move(still)
            slow = np.abs(robot.history.newest().velocities).max() < _REST_RAD_S
            rested = rested + 1 if slow else 0
            if rested_s > until_s:
                return None
        best: tuple[SearchedImage, SearchedImage] | None = None
        while robot.move(still) < until_s:
            left, right = robot.eyes.newest() or (None, None)
            if left is None or right is None or min(left.exposed_s, right.exposed_s) <= rested_s:
                continue
            if abs(left.exposed_s - right.exposed_s) > 0.5 * timing.frame_s:
                continue
            found = [one.detection is not None for one in (left, right)]
            if best is None or sum(found) > sum(one.detection is not None for one in best):
                best = left, right
            if all(found) or left.exposed_s - rested_s > _MAX_WAIT_FRAMES * timing.frame_s:
                break
        return best

    def close(self) -> None:
        """Bring the head to rest and release it."""
        self._plant.close()
