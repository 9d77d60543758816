"""A robot as one thing that is opened, moved outside of trials, brought to rest and closed."""

import dataclasses
import gc
import logging
import time
import warnings
import weakref
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

import numpy as np

from vergence.errors import ChecksFailedError, HardwareError, VergenceWarning
from vergence.hardware.approach import (
    REST_PERIODS,
    REST_RAD_S,
    GoalNotReachedError,
    drive_to,
    drive_to_start,
)
from vergence.hardware.cameras import HeadEyes, compile_loop_kernels
from vergence.hardware.checks import check_local_cameras, check_servos, raise_errors
from vergence.hardware.config import HardwareConfig, load_hardware
from vergence.hardware.drive import DriveThread, JointHistory, RunningTrial
from vergence.hardware.pairing import SearchedImage, SearchedPair
from vergence.hardware.safety.limits import HOLD_PERIODS
from vergence.hardware.safety.supervisor import Supervisor
from vergence.hardware.view_check import compile_view_check, range_by_size, turn_each_joint
from vergence.models.parts import FloatArray
from vergence.recording.events import BoardView, RobotListener
from vergence.vision.detection import BoardDetection
from vergence.vision.objects.targets import FaceTarget, PointTarget
from vergence.vision.targets import PlanarTarget

_LOG: Final = logging.getLogger(__name__)
_FIRST_IMAGES_S: Final = 1.0
"""Longest wait for an image of the head at rest before a trial, s (chosen)."""
_LOOKS: Final = 2
"""Images of each eye that are taken between two turns of the view check (chosen)."""


class Scene:
    """What stands before a head: of the real world nothing is known, and nothing placed in it."""

    places_targets: bool = False

    @contextmanager
    def ahead(self, positions: FloatArray) -> Iterator[None]:
        """Keep the target straight ahead of joint angles, (7,) rad, while the block runs."""
        yield

    def begin(self, now_s: float) -> None:
        """Start the motion of the target: this time is 0 of its path."""

    def pixel(self) -> FloatArray | None:
        """(2,) pixel at which the left eye sees the target; None if that is not known."""
        return None


class Robot:
    """Servos, eyes and supervisor of one head.

    With `moves` false its servos are only read. `named` is True once somebody has named a point.
    """

    def __init__(
        self,
        config: HardwareConfig,
        log: RobotListener | None = None,
        *,
        moves: bool = True,
        view_check: bool = True,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.config, self.target, self.named = config, config.target, False
        self.scene = Scene()
        self.history = JointHistory()
        self.eyes = HeadEyes(config, self.history, log, clock)
        self._log, self._moves, self._view_unchecked = log, moves, view_check
        self._clock, self._sleep = clock, sleep
        self._period_s = config.head.timing.period_s
        self._servos = config.make_servos(clock)
        self._drive: DriveThread | None = None
        self._opened = False
        self._past_overruns = 0
        self.supervisor = self._new_supervisor()

    def _new_supervisor(self) -> Supervisor:
        lower, upper = np.zeros(7), np.zeros(7)
        for servo in self.config.servos:
            lower[servo.slot], upper[servo.slot] = servo.lower_rad, servo.upper_rad
        # longest action of a command: its hold, and the time until the servos stop by themselves
        last_s = HOLD_PERIODS * self._period_s + (self._servos.stops_alone_after_s or 0.0)
        emulated = bool(self.config.emulator_address)
        return Supervisor(
            self.config.safety, self.config.head, lower, upper, self.config.slots, last_s, emulated
        )

    @property
    def drive(self) -> DriveThread:
        """The drive of the open servos; raises a `HardwareError` while they are closed."""
        if self._drive is None:
            raise HardwareError("the head is closed: expected a reset first")
        return self._drive

    def refuse_fault(self) -> None:
        """Raise a `HardwareError` if the head has been stopped, and not released."""
        if self.supervisor.fault:
            raise HardwareError(
                f"{self.supervisor.fault} (the head has been stopped: release it first)"
            )

    def open(self) -> None:
        """Compile the functions of the loop, open the servos and the cameras, and check both."""
        self.refuse_fault()
        if self._drive is not None:
            return
        begun_s = self._clock()
        compile_loop_kernels(self.config.head, self.config.target)
        if self._view_unchecked:
            compile_view_check(self.config)
        gc.freeze()  # a full collection would take longer than the servos' watchdog waits
        try:
            cameras = check_local_cameras(self.config)
            try:
                self._opened = True
                self._servos.open()
                servos = check_servos(self.config, self._servos)
            except ChecksFailedError as error:
                raise ChecksFailedError([*error.findings, *cameras]) from error
            for finding in raise_errors([*servos, *cameras]):
                warn(str(finding))
            if self._moves:
                self._servos.stop()  # what turned before
            self._drive = DriveThread(
                self._servos,
                self.config,
                self.supervisor,
                self.history,
                log=self._log,
                clock=self._clock,
                sleep=self._sleep,
            )
            self._sense()
            while not self.drive.angles.all_reported:
                self._sense()
            self.drive.start()
            self.eyes.open(self._idle)
        except BaseException:
            with suppress(HardwareError):  # the first error has the reason
                self.close()
            raise
        _LOG.info("prepared in %.1f s", self._clock() - begun_s)

    def _idle(self) -> None:
        """Read the joints and wait for a control period."""
        self.drive.sense()
        self._sleep(self._period_s)

    def _sense(self) -> None:
        """Read the joints, and raise an error if a camera has ended or stalled."""
        self.drive.sense()
        self.eyes.check()

    def close(self) -> None:
        """Stop the servos at once and release everything; a second call does nothing."""
        self._past_overruns = self.overruns
        drive, self._drive = self._drive, None
        opened, self._opened = self._opened, False
        try:
            if drive is not None:
                drive.close()
            elif opened:
                self._servos.close()
        finally:
            self.eyes.close()
            gc.unfreeze()

    def brake(self) -> None:
        """Brake to rest, and read that the joints rest; nothing for a closed robot."""
        if self._drive is not None:
            self._drive.brake()

    def release(self) -> None:
        """Close the robot and forget why it was stopped."""
        self.brake()
        self.close()
        self.supervisor = self._new_supervisor()

    def stop(self, reason: str) -> None:
        """Brake as far as the line allows, take the torque of hot servos, and say why."""
        self.supervisor.stop(reason)
        if self._drive is not None:
            self._drive.brake()
            self.supervisor.note_released(self._drive.let_go())
        if self._log is not None:
            self._log.stopped(self.supervisor.fault)
        _LOG.error("stopped: %s", self.supervisor.fault)

    @property
    def is_open(self) -> bool:
        """True from `open` to `close`."""
        return self._drive is not None

    @property
    def overruns(self) -> int:
        """Number of missed control periods so far."""
        return self._past_overruns + (0 if self._drive is None else self._drive.overruns)

    @property
    def remark(self) -> str:
        """See `Plant.remark`."""
        return "" if self.eyes.search is None else self.eyes.search.shared.remark

    @property
    def diagnostics(self) -> dict[str, int]:
        """Counts of paired and lone images, late periods and missed answers."""
        counts, search = self.eyes.counts, self.eyes.search
        refused = 0 if search is None else search.shared.refused
        return {
            "image_pairs": counts.pairs,
            "images_alone_left": counts.unpaired_left,
            "images_alone_right": counts.unpaired_right,
            "late_periods": self.overruns,
            "missed_answers": self._servos.missed_answers,
            **({"jumps_refused": refused} if refused else {}),
        }

    # ---- motion outside of trials ----

    def move(self, requested: FloatArray) -> float:
        """Send requested velocities for one period; return the time after it, s."""
        _, findings = self.drive.period(requested)
        for finding in findings:
            warn(str(finding))
        self.eyes.check()
        return self._clock()

    def exercise(self, velocities: Iterable[FloatArray]) -> None:
        """Move by (7,) rad/s in each period, drawn just before it, as far as safe; then brake."""
        self.refuse_fault()
        try:
            for requested in velocities:
                self.move(requested)
                self.eyes.newest()
            self.drive.brake()
        except HardwareError as error:
            self.stop(str(error))
            raise

    def come_to(self, positions: FloatArray) -> float:
        """Switch torque on and drive to a start, (7,) rad; return the time of rest there, s.

        At the first start the view is checked.
        """
        self.drive.brake()
        try:
            if self.supervisor.fault:  # a joint that did not come to rest
                raise HardwareError(self.supervisor.fault)
            rested_s = self._clock()
            if self._moves:
                for finding in self.drive.switch_on():
                    warn(str(finding))
                rested_s = self._drive_to_start(positions)
            self._search_anew(rested_s)
            if self._view_unchecked:
                self._check_view(positions)
                rested_s = self._drive_to_start(positions)
                self._search_anew(rested_s)
        except HardwareError as error:
            self.stop(str(error))
            raise
        return rested_s

    def _drive_to_start(self, positions: FloatArray) -> float:
        goal = self.config.head.actuation.actuators_of(positions)
        begun_s = self._clock()
        rested_s = drive_to_start(goal, self.config, self.drive.angles, self.supervisor, self.move)
        way_s = rested_s - begun_s
        _LOG.info("neck and actuators driven to %s rad in %.1f s", goal.round(3).tolist(), way_s)
        return rested_s

    def _search_anew(self, rested_s: float) -> None:
        """Forget the target's track; a point is named in an image of the head at rest.

        One that nobody has named is the target before an emulated head.
        """
        if isinstance(self.target, PointTarget):
            self.first_images(rested_s)
        self.eyes.forget()
        own = isinstance(self.target, FaceTarget | PointTarget)
        self.named = own and self.target != PointTarget()
        if self.target == PointTarget() and self.eyes.search is not None:
            pixel = self.scene.pixel()
            if pixel is not None:
                self.eyes.search.shared.click(0, pixel)

    def _check_view(self, positions: FloatArray) -> None:
        """Refuse a configuration that the images contradict, see `vergence.hardware.view_check`."""
        drive = self.drive
        with self.scene.ahead(positions):
            check = turn_each_joint(
                self.config, drive.angles, self.move, lambda: drive.last_sent, self._look
            )
            findings = check.findings(self.target, self.eyes.frames(), self.remark)
        for finding in raise_errors(findings):
            warn(str(finding))
        drive.wake()  # the judgement took its time
        self._view_unchecked = False
        _LOG.info("images move as the configuration says")

    def _look(self, rested_s: float) -> tuple[FloatArray, FloatArray]:
        """(2, 2) pixels and (2,) distances of the target by eye from images after a time, s."""
        head = self.config.head
        seen: tuple[list[SearchedImage], ...] = ([], [])
        until_s = self._clock() + _FIRST_IMAGES_S
        while self._clock() < until_s and min(map(len, seen)) < _LOOKS:
            self.move(np.zeros(7))
            for eye, image in enumerate(self.eyes.newest() or ()):
                if image is not None and image.exposed_s > rested_s:
                    seen[eye].append(image)
        pixels, ranges = np.full((2, 2), np.nan), np.full(2, np.nan)
        for eye, own in enumerate(seen):
            found = [one.pixel for one in own if np.isfinite(one.pixel).all()]
            if found:
                pixels[eye] = np.median(found, axis=0)
            shown = [one.detection for one in own if one.detection is not None]
            if shown and not self.scene.places_targets:  # drawn at a fixed size
                ranges[eye] = np.median([range_by_size(head, eye, one) for one in shown])
        return pixels, ranges

    def first_images(self, rested_s: float) -> SearchedPair | None:
        """Wait for images of the head at rest; the newest ones if none arrives in time."""
        pair = None
        until = self._clock() + _FIRST_IMAGES_S
        while self._clock() < until:
            self._sleep(self._period_s)
            self._sense()
            self.drive.send(np.zeros(7))
            pair = self.eyes.newest()
            if pair is not None and pair.exposed_s > rested_s:
                _LOG.info("first image at rest, exposed %.3f s after it", pair.exposed_s - rested_s)
                return pair
        _LOG.warning("expected an image of the head at rest within %g s", _FIRST_IMAGES_S)
        return pair

    # ---- a trial ----

    def begin(self) -> float:
        """Begin a trial's time now, as nothing has moved until then; return it, s."""
        self.drive.wake()
        now_s = self.drive.start_ticks()
        self.supervisor.begin(now_s)
        self.scene.begin(now_s)
        return now_s

    def step(
        self,
        requested: FloatArray,
        visible: bool,
        goals: FloatArray,
        see: Callable[[SearchedPair], None],
    ) -> None:
        """Hold a policy's command for a period, as far as it is safe; `see` gets new images."""

        def take_images() -> None:
            pair = self.eyes.newest()
            if pair is not None:
                see(pair)

        trial = RunningTrial(
            images_received_s=self.eyes.newest_s,
            target_visible=visible,
            target_eye_angles=goals,
            missed_periods=self.drive.take_missed(),
        )
        _, findings = self.drive.period(requested, trial, take_images)
        for finding in findings:
            warn(str(finding))
        self.eyes.check()
        take_images()


def warn(text: str) -> None:
    """Warn of a problem that does not stop a robot."""
    # `warned` marks the log line, so that a terminal does not show the warning twice
    _LOG.warning("%s", text, extra={"warned": True}, stacklevel=2)
    warnings.warn(text, VergenceWarning, stacklevel=3)


_MAX_SPEED_RAD_S: Final = 0.2
"""Greatest speed of the approach, rad/s (chosen)."""
_TOLERANCE_RAD: Final = 0.003
"""Tolerance of the approach, rad: a servo's least speed ends 2 mrad early (chosen)."""
_APPROACH_TIMEOUT_S: Final = 0.5
"""Longest time for the approach, s: being near is enough (chosen)."""
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
        self._robot = Robot(self._config, view_check=False)
        weakref.finalize(self, self._robot.close)
        self._robot.open()

    def look(self, q: FloatArray) -> BoardView:
        """Bring the head to rest near some joint angles and detect the board once."""
        robot = self._robot
        robot.open()
        robot.come_to(q)
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
        robot, timing = self._robot, self.head.timing
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
        while rested < REST_PERIODS:
            rested_s = robot.move(still)
            slow = np.abs(robot.history.newest().velocities).max() < REST_RAD_S
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
        try:
            self._robot.brake()
        finally:
            self._robot.close()
