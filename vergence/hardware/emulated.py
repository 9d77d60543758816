"""The plant `hardware`: a robot, or an emulated one, whose world places targets, and is known."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from vergence.envs.plants.cameras import BoardImageRenderer
from vergence.envs.reading import Reading, Truth
from vergence.envs.streams import IntArray
from vergence.envs.targets.motion import POINT, Board, motion_rows
from vergence.hardware.config import HardwareConfig
from vergence.hardware.emulator.client import WorldClient
from vergence.hardware.plant import HardwarePlant
from vergence.hardware.robot import Scene
from vergence.hardware.view_check import point_ahead
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.vision.targets import AprilTag


class EmulatedScene(Scene):
    """The world of an emulated head."""

    def __init__(self, config: HardwareConfig) -> None:
        self.places_targets = config.places_targets
        self._head, self._world = config.head, WorldClient(config.emulator_address)
        self._shown: FloatArray | None = None

    def show(self, motion: FloatArray) -> None:
        """Place the target of the next trials; see `vergence.envs.targets.motion`."""
        self._shown = motion
        self._world.place_target(motion)

    @contextmanager
    def ahead(self, positions: FloatArray) -> Iterator[None]:
        """See `Scene.ahead`; nothing before one that nobody has placed."""
        if self._shown is None:
            yield
            return
        point = point_ahead(self._head, positions)
        self._world.place_target(motion_rows(point[np.newaxis], before=point[np.newaxis])[0])
        yield
        self._world.place_target(self._shown)

    def begin(self, now_s: float) -> None:
        """See `Scene.begin`."""
        self._world.start_target_motion(now_s)

    def pixel(self) -> FloatArray | None:
        """See `Scene.pixel`."""
        return np.asarray(self.truth(0.0).pixels[0, 0])

    def truth(self, time_s: float) -> Truth:
        """Ground truth of the present, a time after the trial's start, s."""
        return self._world.truth(self._head, time_s)

    def close(self) -> None:
        """Close the connection."""
        self._world.close()


class RobotPlant(HardwarePlant):
    """A `HardwarePlant` that places targets and knows the truth where its head is emulated."""

    def __init__(self, head: HeadModel, num: int = 1, **options: Any) -> None:
        super().__init__(head, num, **options)
        self.places_targets = self.config.places_targets
        self._world: EmulatedScene | None = None
        self._truth: Truth | None = None

    @property
    def board(self) -> Board:
        """The board before an emulated head; a point for a robot, before which targets are real."""
        target = self.config.target
        if not self.places_targets or not isinstance(target, AprilTag):
            return POINT
        return BoardImageRenderer(self.head, target, width_rad="fit").board

    def prepare(self) -> None:
        """See `HardwarePlant.prepare`."""
        super().prepare()
        if self.config.emulator_address and self._world is None:
            try:
                self.robot.scene = self._world = EmulatedScene(self.config)
            except BaseException:
                self.close()
                raise

    def show(self, ids: IntArray, motions: FloatArray) -> None:
        """Place the target before an emulated head, see `Plant.show`."""
        self.prepare()
        if self._world is not None:
            self._world.show(motions[0])

    def reset(self, ids: IntArray, positions: FloatArray) -> Reading:
        """See `HardwarePlant.reset`."""
        self._truth = None
        return super().reset(ids, positions)

    def step(self, command: FloatArray) -> Reading:
        """See `HardwarePlant.step`."""
        self._truth = None
        return super().step(command)

    def truth(self) -> Truth | None:
        """Ground truth of an emulated head at the last reading.

        None for a real one, before a face, and once somebody has named a point: the emulator does
        not know where these are.
        """
        if self._world is None or self.robot.named:
            return None
        if self._truth is None:
            self._truth = self._world.truth(float(self.reading.time_s[0]))
        return self._truth

    def close(self) -> None:
        """See `HardwarePlant.close`."""
        try:
            super().close()
        finally:
            world, self._world, self.robot.scene = self._world, None, Scene()
            if world is not None:
                world.close()
