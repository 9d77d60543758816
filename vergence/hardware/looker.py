"""One image of a board from each eye of a robot, at rest in a given posture."""

import dataclasses
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Final

import numpy as np

from vergence.errors import HardwareError
from vergence.hardware.config import load_hardware
from vergence.hardware.plant import HardwarePlant
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.recording.events import BoardView, RobotListener
from vergence.recording.schema import LoggedDetection
from vergence.vision.targets import PlanarTarget

_GAIN: Final = 6.0
"""Gain of the approach, speed per remaining angle, 1/s: as on the way to a start (chosen)."""
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

Pair = tuple[LoggedDetection, LoggedDetection]


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
        hardware = dataclasses.replace(load_hardware(config), target=target)
        self.head, self.target = hardware.head, target
        own = hardware.servos
        self._slots = [servo.slot for servo in own]
        self._lower = np.array([servo.lower_rad for servo in own])
        self._upper = np.array([servo.upper_rad for servo in own])
        self._heard = _Heard()
        self._plant = HardwarePlant(self.head, config=hardware, log=self._heard, view_check=False)
        self._plant.prepare()

    def look(self, q: FloatArray) -> BoardView:
        """Bring the head to rest near some joint angles and detect the board once.

        Args:
            q: (7,) joint angles, rad; clipped to the servos' limits.

        Raises:
            HardwareError: the head has been stopped, does not get there or does not come to rest,
                or gives no images.
        """
        self._plant.reset(np.array([0]), q[np.newaxis])
        self._heard.clear()
        seen: list[Pair] = []
        self._plant.exercise(self._look(q, seen))
        if not seen:
            raise HardwareError(
                "cameras: expected images of both eyes at rest, at most half a frame apart, within "
                f"{_TIMEOUT_S:g} s, got none"
            )
        pair = seen[0]
        return BoardView(
            time_s=0.5 * (pair[0].exposed_s + pair[1].exposed_s),
            positions=0.5 * (pair[0].positions + pair[1].positions),
            corners_px=(_shown(pair[0].corners_px), _shown(pair[1].corners_px)),
            sigma_px=(_shown(pair[0].corners_sigma_px), _shown(pair[1].corners_sigma_px)),
        )

    def _look(self, q: FloatArray, seen: list[Pair]) -> Iterator[FloatArray]:
        """Yield velocities, (7,) rad/s, until `seen` holds a pair of images of the head at rest."""
        heard, timing, actuation = self._heard, self.head.timing, self.head.actuation
        goal = np.clip(actuation.actuators_of(q)[self._slots], self._lower, self._upper)
        still = np.zeros(7)
        yield still
        begun_s = heard.clock_s
        while heard.clock_s - begun_s < _APPROACH_TIMEOUT_S:
            left = goal - actuation.actuators_of(heard.positions)[self._slots]
            if np.abs(left).max() < _TOLERANCE_RAD:
                break
            requested = still.copy()
            requested[self._slots] = np.clip(_GAIN * left, -_MAX_SPEED_RAD_S, _MAX_SPEED_RAD_S)
            yield requested
        rested, until_s = 0, heard.clock_s + _TIMEOUT_S
        while rested < _REST_PERIODS and heard.clock_s < until_s:
            yield still
            rested = rested + 1 if np.abs(heard.velocities).max() < _REST_RAD_S else 0
        if rested < _REST_PERIODS:
            return
        rested_s = heard.clock_s
        while heard.clock_s < until_s:
            yield still
            pairs = heard.pairs(rested_s, 0.5 * timing.frame_s)
            if not pairs:
                continue
            best = max(pairs, key=_found)
            waited = pairs[-1][0].exposed_s - rested_s > _MAX_WAIT_FRAMES * timing.frame_s
            if _found(best) == len(EYE_NAMES) or waited:
                seen.append(best)
                return

    def close(self) -> None:
        """Bring the head to rest and release it."""
        self._plant.close()


class _Heard(RobotListener):
    """Listener that keeps the newest joint angles, and the detections since the last `clear`."""

    def __init__(self) -> None:
        self.clock_s = 0.0
        self.positions = self.velocities = np.zeros(7)
        self.clear()

    def clear(self) -> None:
        self._seen: dict[str, list[LoggedDetection]] = {name: [] for name in EYE_NAMES}

    def joints(self, clock_s: float, positions: FloatArray, velocities: FloatArray) -> None:
        """See `RobotListener.joints`."""
        self.clock_s, self.positions, self.velocities = clock_s, positions, velocities

    def detection(self, found: LoggedDetection) -> None:
        """See `RobotListener.detection`."""
        self._seen[found.eye].append(found)

    def pairs(self, since_s: float, apart_s: float) -> list[Pair]:
        """Pairs of detections after `since_s`, at most `apart_s` apart, in order of time."""
        left, right = (
            [one for one in self._seen[name] if one.exposed_s > since_s] for name in EYE_NAMES
        )
        return [
            (one, other)
            for one, other in product(left, right)
            if abs(one.exposed_s - other.exposed_s) <= apart_s
        ]


def _found(pair: Pair) -> int:
    """Number of eyes that have found the board."""
    return sum(len(one.corners_px) > 0 for one in pair)


def _shown(corners: FloatArray) -> FloatArray | None:
    return corners if len(corners) else None
