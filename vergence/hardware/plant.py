"""The plant of a real head: servos that take speeds, cameras, and a schedule.

In each control period the plant sends the command, waits for the schedule's next tick, and reads
the joints; camera threads receive the images meanwhile. Where servos stop by themselves without
commands, they do so after a given time.
"""

import dataclasses
import logging
import time
import weakref
from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from vergence.envs.plant import Plant
from vergence.envs.reading import Image, Reading
from vergence.envs.streams import IntArray
from vergence.errors import ConfigurationError, HardwareError
from vergence.hardware.config import HardwareConfig, load_hardware, refuse_other_head
from vergence.hardware.drive import JointHistory
from vergence.hardware.pairing import SearchedPair, merge_pair
from vergence.hardware.robot import Robot, warn
from vergence.hardware.safety.supervisor import target_eye_angles
from vergence.models.camera import Camera
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.recording.events import RobotListener
from vergence.vision.detection import as_pixel
from vergence.vision.objects.sights import line_of_sight, pixel_of
from vergence.vision.objects.targets import GazeTarget, PlaceTarget, PointTarget, parse_gaze_target

_LOG: Final = logging.getLogger(__name__)


class HardwarePlant(Plant):
    """One real head with servos on a bus and two cameras; for an emulated one see `RobotPlant`.

    Nothing moves before the first `reset`; `prepare` opens the line and the cameras.

    Args:
        head: the model that a controller uses; it has to be that of the configuration.
        num: number of heads: 1.
        config: the hardware configuration, or the path of its file, see
            `vergence.hardware.config`.
        log: receives all events; None for no log.
        moves: True if the servos move; if False they are only read, never written to.
        look: what the eyes look for in place of the configuration's target, see
            `parse_gaze_target`.
        view_check: True to compare, before the first trial, what the images do while each joint
            turns with what the configuration says; the target has to be in view then.
        appears: True if the target appears at a trial's start, as a simulated one does: images
            exposed before it are ignored.
        clock: a monotonic clock, s.
        sleep: waits for some seconds.

    Attributes:
        config: the hardware configuration.
        robot: its servos, eyes and supervisor, which also move outside of trials.
        reading: the newest sensor values, in arrays that every step updates in place.
        begun_s: time on the clock at which the running trial began, s.
        trials: number of trials so far.

    Raises:
        ConfigurationError: num is not 1, or the head differs from the configuration's.
        HeadFileError: the configuration has a mistake.
    """

    max_num = 1

    def __init__(
        self,
        head: HeadModel,
        num: int = 1,
        *,
        config: str | HardwareConfig,
        log: RobotListener | None = None,
        moves: bool = True,
        appears: bool = False,
        look: str | None = None,
        view_check: bool = True,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        if num != 1:
            raise ConfigurationError(f"num: expected 1, as there is one real head, got {num}")
        self.config = config if isinstance(config, HardwareConfig) else load_hardware(config)
        refuse_other_head(self.config, head)
        if look is not None:
            self.config = dataclasses.replace(self.config, target=parse_gaze_target(look))
        self.head, self.num = head, num
        self._log, self._clock = log, clock
        # a place's pixels are computed, and a point that nobody has named yet has none
        target = self.config.target
        by_images = not isinstance(target, PlaceTarget) and target != PointTarget()
        view_check = view_check and moves and self.config.safety.view_check and by_images
        self.robot = Robot(
            self.config, log, moves=moves, view_check=view_check, clock=clock, sleep=sleep
        )
        # runs when the plant is deleted or the process ends, whichever comes first
        weakref.finalize(self, self.robot.close)
        self._values = _Values(head, self.robot.history, appears)
        self.reading = self._values.reading
        self._ready = self._begun = False
        self._warned_posture = ""
        self.begun_s = 0.0
        self.trials = 0

    @property
    def fault(self) -> str:
        """See `Plant.fault`; `close` and `prepare` keep it, `release` clears it."""
        return self.robot.supervisor.fault

    @property
    def remark(self) -> str:
        """See `Plant.remark`."""
        return self.robot.remark

    @property
    def overruns(self) -> int:
        """Number of missed control periods so far."""
        return self.robot.overruns

    def release(self) -> None:
        """See `Plant.release`: the next `reset` opens and checks everything again."""
        self.close()
        self.robot.release()
        _LOG.info("released")

    def rest(self, reason: str) -> None:
        """See `Plant.rest`."""
        self.robot.stop(reason)

    def prepare(self) -> None:
        """Compile the functions of the loop, open the line and the cameras, and check both.

        Raises:
            ChecksFailedError: something is wrong with servos or cameras; it lists all problems.
            HardwareError: a camera gives no images, or the head has been stopped.
            ConfigurationError: a camera cannot be opened.
        """
        self.robot.open()

    def look_for(self, target: GazeTarget) -> None:
        """Detect another target from the next images on.

        Raises:
            VergenceError: see `prepare`.
        """
        self.prepare()
        self.robot.target = target
        self.robot.eyes.look_for(target)

    def click(self, eye: int, pixel: ArrayLike, exposed_s: float) -> None:
        """Follow the point at a pixel (u, v) that an eye saw a while ago.

        Args:
            eye: 0 for left, 1 for right.
            pixel: (2,) raw pixel.
            exposed_s: time of that image's exposure, s of the clock; the eye may have turned since.

        Raises:
            ConfigurationError: the target is no point, or it has left the eye's view.
        """
        search = self.robot.eyes.search
        if search is None:
            raise ConfigurationError("click: expected an open head, got a closed one")
        camera, history = Camera.of(self.head, eye), self.robot.history
        then, now = (
            self.head.base_pose(q) @ self.head.camera_poses(q)
            for q in (history.at(exposed_s), history.newest().positions)
        )
        ray = line_of_sight(camera, then[eye], as_pixel("pixel", pixel))
        search.shared.click(eye, pixel_of(camera, now[eye], now[eye, :3, 3] + ray))
        self.robot.named = True

    def reset(self, ids: IntArray, positions: FloatArray) -> Reading:
        """Drive the joints to the start of a trial, and begin it; see `Plant.reset`.

        Raises:
            HardwareError: they do not get there, the head does not answer, or it has been stopped
                and not released.
        """
        self.robot.refuse_fault()
        self.prepare()
        self._ready = self._begun = False
        rested_s = self.robot.come_to(positions[0])
        pair = self.robot.first_images(rested_s)
        self.begun_s = self._clock()
        self.robot.scene.begin(self.begun_s)
        self._values.begin(self.begun_s, pair)
        self._ready, self._warned_posture = True, ""
        self.trials += 1
        _LOG.info("trial %d begins", self.trials)
        if self._log is not None:
            self._log.begin()
            _keep(self, self._log)
        return self.reading

    def step(self, command: FloatArray) -> Reading:
        """Send a command as far as it is safe, and hold it for one control period.

        If something is wrong the joints are brought to rest, and `fault` gives the reason.

        Raises:
            ConfigurationError: the shape of the command is wrong.
            HardwareError: the head is closed, or it has been stopped and not released.
        """
        command, robot = _checked(command), self.robot
        if not self._begun:
            robot.refuse_fault()
            if not self._ready:
                raise HardwareError("the head has not begun a trial: expected a reset first")
            self.begun_s = self._values.begun_s = robot.begin()
            self._begun = True
        try:
            visible = bool(self.reading.visible[0].any())
            robot.step(command[0], visible, self._values.goals, self._values.see)
            self.reading.command[0] = robot.drive.sent
            self._values.update(robot.drive.tick * self.head.timing.period_s)
            if self._log is not None:
                _keep(self, self._log)
        except HardwareError as error:
            robot.drive.note_pause()
            robot.supervisor.stop(str(error))
        name = robot.supervisor.limiting_posture
        if name and name != self._warned_posture:  # once a trial
            self._warned_posture = name
            warn(f"safety: the forbidden posture {name!r} is in the policy's way")
        if robot.supervisor.fault:
            robot.stop(robot.supervisor.fault)
            self._begun = False
        return self.reading

    def frames(self, place: int = 0) -> tuple[Image, Image] | None:
        """See `Plant.frames`."""
        return self.robot.eyes.frames()

    def diagnostics(self) -> dict[str, int]:
        """Counts of paired and lone images, late periods and missed answers."""
        return self.robot.diagnostics

    def close(self) -> None:
        """Bring the servos to rest, and release the line and the cameras."""
        self._ready = self._begun = False
        opened, counts = self.robot.is_open, self.robot.diagnostics
        try:
            self.robot.brake()
        finally:
            self.robot.close()
        if opened:
            said = (f"{name.replace('_', ' ')} {count}" for name, count in counts.items())
            _LOG.info("closed: %s", ", ".join(said))


class _Values:
    """The sensor values of a trial, updated in place.

    Attributes:
        goals: (4,) angles at which the eye joints look at the target, rad; nan if unknown.
        begun_s: the trial's time zero, s of the clock; setting it dates the values anew.
    """

    def __init__(self, head: HeadModel, history: JointHistory, appears: bool) -> None:
        self.reading, self.goals = Reading.empty(1), np.full(4, np.nan)
        self._head, self._history, self._appears = head, history, appears
        self._begun_s, self._new = 0.0, False

    @property
    def begun_s(self) -> float:
        return self._begun_s

    @begun_s.setter
    def begun_s(self, begun_s: float) -> None:
        own = self.reading
        for times in (own.exposure_s, own.received_s, own.joints_s):
            times -= begun_s - self._begun_s
        self._begun_s = begun_s

    def begin(self, begun_s: float, pair: SearchedPair | None) -> None:
        """Begin a trial with images of the head at rest."""
        for own, empty in zip(self.reading, Reading.empty(1), strict=True):
            own[:] = empty
        self._begun_s, self._new = begun_s, False
        if pair is not None:
            self.see(pair)
        self.update(0.0)
        self.reading.frame[0] = 0

    def update(self, time_s: float) -> None:
        """Take the newest joint angles, and count the images that `see` has taken."""
        reading = self.reading
        measured_s, q, v = self._history.newest()
        reading.time_s[0] = time_s
        reading.joints_s[0] = measured_s - self._begun_s
        reading.positions[0], reading.velocities[0] = q, v
        reading.frame[0] += self._new
        self._new = False

    def see(self, pair: SearchedPair) -> None:
        """Take new images."""
        reading, begun_s = self.reading, self._begun_s
        exposed_s, pixels = merge_pair(self._head, pair, self._history)
        if self._appears and exposed_s < begun_s:
            return
        self._new = True
        reading.exposure_s[0] = exposed_s - begun_s
        reading.received_s[0] = pair.ready_s - begun_s
        reading.positions_at_exposure[0] = self._history.at(exposed_s)
        self.goals = target_eye_angles(self._head, reading.positions_at_exposure[0], pixels)
        reading.pixels[0] = pixels
        reading.visible[0] = np.isfinite(pixels).all(axis=-1)


def _keep(plant: Plant, log: RobotListener) -> None:
    """Log the present reading and ground truth."""
    log.reading(plant.reading, plant.begun_s)  # type: ignore[attr-defined]
    truth = plant.truth()
    if truth is not None:
        log.truth(truth)


def _checked(command: FloatArray) -> FloatArray:
    """Check a command of one head, and convert it to floats."""
    given = np.asarray(command)
    if given.shape != (1, 7):
        raise ConfigurationError(f"command: expected shape (1, 7), got {given.shape}")
    if given.dtype.kind not in "fiu":
        raise ConfigurationError(f"command: expected numbers, got an array of {given.dtype}")
    return given.astype(np.float64)
