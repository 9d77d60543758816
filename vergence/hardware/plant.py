"""The plant of a real head: servos in velocity mode, cameras, and a schedule.

In each control period the plant sends the command, waits for the schedule's next tick, and reads
the joints; camera threads receive the images meanwhile. The servos' own bus watchdog stops them if
no packet arrives for a given time.
"""

import dataclasses
import gc
import logging
import time
import warnings
import weakref
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from vergence.envs.plant import Plant
from vergence.envs.plants.cameras import BoardImageRenderer
from vergence.envs.reading import Image, Reading, Truth
from vergence.envs.streams import IntArray
from vergence.envs.targets.motion import POINT, Board, motion_rows
from vergence.errors import ChecksFailedError, ConfigurationError, HardwareError, VergenceWarning
from vergence.hardware.camera_checks import check_local_cameras
from vergence.hardware.checks.servos import raise_errors
from vergence.hardware.common_time import merge_pair
from vergence.hardware.compiling import compile_loop_kernels
from vergence.hardware.config import (
    HardwareConfig,
    load_hardware,
    refuse_other_head,
)
from vergence.hardware.count_log import CountLog
from vergence.hardware.drive import DriveThread, RunningTrial
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.emulator.client import WorldClient
from vergence.hardware.eyes import HeadEyes
from vergence.hardware.history import JointHistory
from vergence.hardware.opened import OpenedHead
from vergence.hardware.pairing import SearchedImage, SearchedPair
from vergence.hardware.safety.goals import target_eye_angles
from vergence.hardware.safety.motion import HOLD_PERIODS
from vergence.hardware.safety.supervisor import Supervisor
from vergence.hardware.servo_angles import ServoAngles
from vergence.hardware.servos import HeadServos
from vergence.hardware.start import drive_to_start
from vergence.hardware.still import ReadOnlyServos
from vergence.hardware.view_check import (
    compile_view_check,
    point_ahead,
    range_by_size,
    turn_each_joint,
)
from vergence.models.camera import Camera
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.recording.events import RobotListener
from vergence.vision.detection import as_pixel
from vergence.vision.objects.sights import line_of_sight, pixel_of
from vergence.vision.objects.targets import (
    FaceTarget,
    GazeTarget,
    PlaceTarget,
    PointTarget,
    parse_gaze_target,
)
from vergence.vision.targets import AprilTag

_LOG: Final = logging.getLogger(__name__)
_FIRST_IMAGES_S: Final = 1.0
"""Longest wait for an image of the head at rest before a trial, s (chosen)."""


_LOOKS: Final = 2
"""Images of each eye that are taken between two turns of the view check (chosen)."""


class HardwarePlant(Plant):
    """One real head with servos on a serial line and two cameras, or an emulated one.

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
        begun_s: time on the clock at which the running trial began, s.
        overruns: number of missed control periods.
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
        self.places_targets = self.config.places_targets
        self.overruns = 0
        self._log, self._moves, self._appears = log, moves, appears
        # a place's pixels are computed, and a point that nobody has named yet has none
        target = self.config.target
        by_images = not isinstance(target, PlaceTarget) and target != PointTarget()
        self._view_unchecked = view_check and moves and self.config.safety.view_check and by_images
        self._shown: FloatArray | None = None
        self._target = target
        self._clock, self._sleep = clock, sleep
        self._period_s = head.timing.period_s
        self._reading = Reading.empty(1)
        self._history = JointHistory()
        self._open = OpenedHead(HeadEyes(self.config, self._history, log, clock))
        # runs when the plant is deleted or the process ends, whichever comes first
        weakref.finalize(self, self._open.close)
        self._prepared = self._ready = self._begun = False
        self._warned_posture = ""
        self.begun_s = 0.0
        self._tick = self._reported_overruns = self.trials = 0
        self._missed = CountLog(_LOG, logging.WARNING, "periods missed: %d", clock)
        self._goals = np.full(4, np.nan)
        self._truth: Truth | None = None
        self._named = False
        self._supervisor = self._new_supervisor()

    def _new_supervisor(self) -> Supervisor:
        lower, upper = np.zeros(7), np.zeros(7)
        for servo in self.config.servos:
            lower[servo.slot], upper[servo.slot] = servo.lower_rad, servo.upper_rad
        # longest action of a command: its hold, the watchdog time, and the watchdog's time unit
        last_s = HOLD_PERIODS * self._period_s + self.config.bus.watchdog_s + table.WATCHDOG_S
        emulated = bool(self.config.emulator_address)
        return Supervisor(
            self.config.safety, self.head, lower, upper, self.config.slots, last_s, emulated
        )

    @property
    def fault(self) -> str:
        """See `Plant.fault`; `close` and `prepare` keep it, `release` clears it."""
        return self._supervisor.fault

    @property
    def remark(self) -> str:
        """See `Plant.remark`."""
        return "" if self._open.eyes.search is None else self._open.eyes.search.shared.remark

    def release(self) -> None:
        """See `Plant.release`: the next `reset` opens and checks everything again."""
        self.close()
        self._supervisor = self._new_supervisor()
        _LOG.info("released")

    def rest(self, reason: str) -> None:
        """See `Plant.rest`."""
        self._supervisor.stop(reason)
        self._come_to_rest()

    @property
    def reading(self) -> Reading:
        """The newest sensor values, in arrays that every step updates in place."""
        return self._reading

    def prepare(self) -> None:
        """Compile the functions of the loop, open the line and the cameras, and check both.

        Raises:
            ChecksFailedError: something is wrong with servos or cameras; it lists all problems.
            HardwareError: a camera gives no images, or the head has been stopped.
            ConfigurationError: a camera cannot be opened.
        """
        self._refuse_fault()
        if self._prepared:
            return
        begun_s = self._clock()
        compile_loop_kernels(self.head, self.config.target)
        if self._view_unchecked:
            compile_view_check(self.config)
        gc.freeze()  # a full collection would take longer than the servos' watchdog waits
        try:
            cameras = check_local_cameras(self.config)
            try:
                make = HeadServos if self._moves else ReadOnlyServos
                servos = make(self.config, self._clock)
            except ChecksFailedError as error:
                raise ChecksFailedError([*error.findings, *cameras]) from error
            self._open.drive = DriveThread(
                servos,
                self.config,
                self._supervisor,
                self._history,
                log=self._log,
                clock=self._clock,
                sleep=self._sleep,
            )
            for finding in raise_errors([*servos.findings, *cameras]):
                _warn(str(finding))
            self._sense()
            self._open.drive.start()
            self._open.eyes.open(self._idle)
            if self.config.emulator_address:
                self._open.world = WorldClient(self.config.emulator_address)
        except BaseException:
            self.close()
            raise
        self._prepared = True
        _LOG.info("prepared in %.1f s", self._clock() - begun_s)

    def _idle(self) -> None:
        """Read the joints and wait for a control period."""
        self._drive.sense()
        self._sleep(self._period_s)

    @property
    def board(self) -> Board:
        """The board before an emulated head; a point for a robot, before which targets are real."""
        target = self.config.target
        if not self.places_targets or not isinstance(target, AprilTag):
            return POINT
        return BoardImageRenderer(self.head, target, width_rad="fit").board

    def look_for(self, target: GazeTarget) -> None:
        """Detect another target from the next images on.

        Raises:
            VergenceError: see `prepare`.
        """
        self.prepare()
        self._target = target
        self._open.eyes.look_for(target)

    def click(self, eye: int, pixel: ArrayLike, exposed_s: float) -> None:
        """Follow the point at a pixel (u, v) that an eye saw a while ago.

        Args:
            eye: 0 for left, 1 for right.
            pixel: (2,) raw pixel.
            exposed_s: time of that image's exposure, s of the clock; the eye may have turned since.

        Raises:
            ConfigurationError: the target is no point, or it has left the eye's view.
        """
        if self._open.eyes.search is None:
            raise ConfigurationError("click: expected an open head, got a closed one")
        camera = Camera.of(self.head, eye)
        then, now = (
            self.head.base_pose(q) @ self.head.camera_poses(q)
            for q in (self._history.at(exposed_s), self._history.newest()[1])
        )
        ray = line_of_sight(camera, then[eye], as_pixel("pixel", pixel))
        self._open.eyes.search.shared.click(eye, pixel_of(camera, now[eye], now[eye, :3, 3] + ray))
        self._named = True

    def show(self, ids: IntArray, motions: FloatArray) -> None:
        """Place the target before an emulated head, see `Plant.show`."""
        self.prepare()
        if self._open.world is not None:
            self._shown = motions[0]
            self._open.world.place_target(motions[0])

    def reset(self, ids: IntArray, positions: FloatArray) -> Reading:
        """Drive the joints to the start of a trial, and begin it; see `Plant.reset`.

        Raises:
            HardwareError: they do not get there, the head does not answer, or it has been stopped
                and not released.
        """
        self._refuse_fault()
        self.prepare()
        self._ready = self._begun = False
        self._drive.brake()
        try:
            with self._drive.exclusive() as servos:
                servos.switch_on()
                angles = servos.angles
            rested_s = self._come_to_start(positions[0], angles) if self._moves else self._clock()
            self._search_anew(rested_s)
            if self._view_unchecked:
                self._check_view(positions[0], angles)
                rested_s = self._come_to_start(positions[0], angles)
                self._search_anew(rested_s)
        except HardwareError as error:
            self.rest(str(error))
            raise
        blank = Reading.empty(1)
        for own, empty in zip(self._reading, blank, strict=True):
            own[:] = empty
        pair = self._first_images(rested_s)
        self.begun_s, self._tick = self._clock(), 0
        if self._open.world is not None:
            self._open.world.start_target_motion(self.begun_s)
        self._report(pair)
        self._reading.frame[0] = 0
        self._reading.command[:] = 0.0
        self._ready, self._warned_posture = True, ""
        self.trials += 1
        _LOG.info("trial %d begins", self.trials)
        if self._log is not None:
            self._log.begin()
            self._keep(self._log)
        return self._reading

    def step(self, command: FloatArray) -> Reading:
        """Send a command as far as it is safe, and hold it for one control period.

        If something is wrong the joints are brought to rest, and `fault` gives the reason.

        Raises:
            ConfigurationError: the shape of the command is wrong.
            HardwareError: the head is closed, or it has been stopped and not released.
        """
        command = _checked(command)
        self._truth = None
        if not self._begun:
            self._refuse_fault()
            if not self._ready:
                raise HardwareError("the head has not begun a trial: expected a reset first")
            self._begin()
        try:
            missed = self.overruns - self._reported_overruns
            self._reported_overruns = self.overruns
            trial = RunningTrial(
                images_received_s=self._open.eyes.newest_s,
                target_visible=bool(self._reading.visible[0].any()),
                target_eye_angles=self._goals,
                missed_periods=missed,
            )
            self._reading.command[0] = self._drive.send(command[0], trial)
            self._warn_of_limiting_posture()
            self._wait()
            self._sense()
            self._check_health()
            self._report(self._open.eyes.newest())
            if self._log is not None:
                self._keep(self._log)
        except HardwareError as error:
            self._drive.note_pause()
            self._supervisor.stop(str(error))
        if self._supervisor.fault:
            self._come_to_rest()
            self._begun = False
        return self._reading

    def frames(self, place: int = 0) -> tuple[Image, Image] | None:
        """See `Plant.frames`."""
        return self._open.eyes.frames()

    def truth(self) -> Truth | None:
        """Ground truth of an emulated head at the last reading.

        None for a real one, before a face, and once somebody has named a point: the emulator does
        not know where these are.
        """
        if self._open.world is None or self._named:
            return None
        if self._truth is None:
            self._truth = self._open.world.truth(self.head, float(self._reading.time_s[0]))
        return self._truth

    def _keep(self, log: RobotListener) -> None:
        """Log the present reading and ground truth."""
        log.reading(self._reading, self.begun_s)
        truth = self.truth()
        if truth is not None:
            log.truth(truth)

    def diagnostics(self) -> dict[str, int]:
        """Counts of paired and lone images, late periods and missed answers."""
        counts, search = self._open.eyes.counts, self._open.eyes.search
        refused = 0 if search is None else search.shared.refused
        return {
            "image_pairs": counts.pairs,
            "images_alone_left": counts.unpaired_left,
            "images_alone_right": counts.unpaired_right,
            "late_periods": self.overruns,
            "missed_answers": 0 if self._open.drive is None else self._open.drive.missed_answers,
            **({"jumps_refused": refused} if refused else {}),
        }

    def close(self) -> None:
        """Bring the servos to rest, and release the line and the cameras."""
        self._prepared = self._ready = self._begun = False
        opened, counts = self._open.drive is not None, self.diagnostics()
        try:
            if self._open.drive is not None:
                self._open.drive.brake()
        finally:
            self._open.close()
            gc.unfreeze()
        if opened:
            said = (f"{name.replace('_', ' ')} {count}" for name, count in counts.items())
            _LOG.info("closed: %s", ", ".join(said))

    def exercise(self, velocities: Iterable[FloatArray]) -> None:
        """Move the joints outside a trial, one command per period, as far as safe; then brake.

        Args:
            velocities: requested velocities, (7,) each, rad/s; each is drawn just before it is
                sent.

        Raises:
            HardwareError: the head has been stopped, or stops.
        """
        self._refuse_fault()
        try:
            for requested in velocities:
                self._move(requested)
                self._open.eyes.newest()
            self._drive.brake()
        except HardwareError as error:
            self.rest(str(error))
            raise

    # ---- the loop ----

    @property
    def _drive(self) -> DriveThread:
        if self._open.drive is None:
            raise HardwareError("the head is closed: expected a reset first")
        return self._open.drive

    def _refuse_fault(self) -> None:
        if self._supervisor.fault:
            raise HardwareError(
                f"{self._supervisor.fault} (the head has been stopped: release it first)"
            )

    def _come_to_start(self, positions: FloatArray, angles: ServoAngles) -> float:
        """Drive the joints to the start of a trial; return the time of rest there, s."""
        goal = self.head.actuation.actuators_of(positions)
        begun_s = self._clock()
        rested_s = drive_to_start(goal, self.config, angles, self._supervisor, self._move)
        way_s = rested_s - begun_s
        _LOG.info("neck and actuators driven to %s rad in %.1f s", goal.round(3).tolist(), way_s)
        return rested_s

    def _check_view(self, positions: FloatArray, angles: ServoAngles) -> None:
        """Refuse a configuration that the images contradict, see `vergence.hardware.view_check`."""
        world, shown = self._open.world, self._shown
        if world is not None and shown is not None:
            ahead = point_ahead(self.head, positions)[np.newaxis]
            world.place_target(motion_rows(ahead, before=ahead)[0])
        check = turn_each_joint(
            self.config, angles, self._move, lambda: self._drive.last_sent, self._look
        )
        findings = check.findings(self._target, self._open.eyes.frames(), self.remark)
        if world is not None and shown is not None:
            world.place_target(shown)
        for finding in raise_errors(findings):
            _warn(str(finding))
        with self._drive.exclusive() as servos:
            if servos.watchdog_trip_pause_s():  # the judgement took its time
                servos.switch_on()
        self._view_unchecked = False
        _LOG.info("images move as the configuration says")

    def _look(self, rested_s: float) -> tuple[FloatArray, FloatArray]:
        """(2, 2) pixels and (2,) distances of the target by eye from images after a time, s."""
        seen: tuple[list[SearchedImage], ...] = ([], [])
        until_s = self._clock() + _FIRST_IMAGES_S
        while self._clock() < until_s and min(map(len, seen)) < _LOOKS:
            self._move(np.zeros(7))
            for eye, image in enumerate(self._open.eyes.newest() or ()):
                if image is not None and image.exposed_s > rested_s:
                    seen[eye].append(image)
        pixels = [[one.pixel for one in own if np.isfinite(one.pixel).all()] for own in seen]
        ranges = [
            [
                range_by_size(self.head, eye, one.detection)
                for one in own
                if one.detection is not None and not self.places_targets  # drawn at a fixed size
            ]
            for eye, own in enumerate(seen)
        ]
        return (
            np.array([np.median(own, axis=0) if own else np.full(2, np.nan) for own in pixels]),
            np.array([np.median(own) if own else np.nan for own in ranges]),
        )

    def _move(self, requested: FloatArray) -> float:
        """Send requested velocities for one period outside a trial; return the time after it, s."""
        now = self._drive.move(requested)
        self._open.eyes.check()
        self._check_health()
        return now

    def _search_anew(self, rested_s: float) -> None:
        """Forget the target's track; a point is named in an image of the head at rest.

        One that nobody has named is the target before an emulated head.
        """
        if isinstance(self._target, PointTarget):
            self._first_images(rested_s)
        self._open.eyes.forget()
        own = isinstance(self._target, FaceTarget | PointTarget)
        self._named = own and self._target != PointTarget()
        world, search = self._open.world, self._open.eyes.search
        if world is not None and search is not None and self._target == PointTarget():
            search.shared.click(0, world.truth(self.head, 0.0).pixels[0, 0])

    def _come_to_rest(self) -> None:
        """Brake as far as the line allows, switch the torque of hot servos off, and say so."""
        if self._open.drive is not None:
            self._open.drive.brake()
            with suppress(HardwareError), self._open.drive.exclusive() as servos:
                servos.release_torque_if_hot()
            self._supervisor.note_released(self._open.drive.released)
        if self._log is not None:
            self._log.stopped(self._supervisor.fault)
        _LOG.error("stopped: %s", self._supervisor.fault)

    def _warn_of_limiting_posture(self) -> None:
        """Warn, once a trial, of a forbidden posture that the policy's commands would enter."""
        name = self._supervisor.limiting_posture
        if name and name != self._warned_posture:
            self._warned_posture = name
            _warn(f"safety: the forbidden posture {name!r} is in the policy's way")

    def _check_health(self) -> None:
        with self._drive.exclusive() as servos:
            texts = servos.check_health()
        for text in texts:
            _warn(text)

    def _begin(self) -> None:
        """Start the trial's time at its first command, as nothing has moved until then."""
        with self._drive.exclusive() as servos:
            if servos.watchdog_trip_pause_s():
                servos.switch_on()
        now = self._clock()
        self._supervisor.begin(now)
        self._reported_overruns = self.overruns
        later = now - self.begun_s
        self.begun_s, self._tick, self._begun = now, 0, True
        for times in (self._reading.exposure_s, self._reading.received_s, self._reading.joints_s):
            times -= later
        if self._open.world is not None:
            self._open.world.start_target_motion(now)

    def _wait(self) -> None:
        """Wait for the schedule's next tick; ticks that are a period late are skipped."""
        self._tick += 1
        due_s = self.begun_s + self._tick * self._period_s
        left_s = due_s - self._clock()
        if left_s > 0.0:
            self._sleep(left_s)
        missed = int((self._clock() - due_s) // self._period_s)
        if missed > 0:
            self._tick += missed
            self.overruns += missed
            self._missed.add(missed)

    def _sense(self) -> None:
        """Read the joints, and raise an error if a camera has ended or stalled."""
        self._drive.sense()
        self._open.eyes.check()

    def _first_images(self, rested_s: float) -> SearchedPair | None:
        """Wait for images of the head at rest; the newest ones if none arrives in time."""
        pair = None
        until = self._clock() + _FIRST_IMAGES_S
        while self._clock() < until:
            self._sleep(self._period_s)
            self._sense()
            self._drive.send(np.zeros(7))
            pair = self._open.eyes.newest()
            if pair is not None and pair.exposed_s > rested_s:
                _LOG.info("first image at rest, exposed %.3f s after it", pair.exposed_s - rested_s)
                break
        else:
            _LOG.warning("expected an image of the head at rest within %g s", _FIRST_IMAGES_S)
        return pair

    def _report(self, pair: SearchedPair | None) -> None:
        """Update the reading from the newest joint angles and images."""
        reading, self._truth = self._reading, None
        measured_s, q, v = self._history.newest()
        reading.time_s[0] = self._tick * self._period_s
        reading.joints_s[0] = measured_s - self.begun_s
        reading.positions[0], reading.velocities[0] = q, v
        if pair is None:
            return
        exposed_s, pixels = merge_pair(self.head, pair, self._history)
        if self._appears and exposed_s < self.begun_s:
            return
        reading.frame[0] += 1
        reading.exposure_s[0] = exposed_s - self.begun_s
        reading.received_s[0] = pair.ready_s - self.begun_s
        reading.positions_at_exposure[0] = self._history.at(exposed_s)
        self._goals = target_eye_angles(self.head, reading.positions_at_exposure[0], pixels)
        reading.pixels[0] = pixels
        reading.visible[0] = np.isfinite(pixels).all(axis=-1)


def _checked(command: FloatArray) -> FloatArray:
    """Check a command of one head, and convert it to floats."""
    given = np.asarray(command)
    if given.shape != (1, 7):
        raise ConfigurationError(f"command: expected shape (1, 7), got {given.shape}")
    if given.dtype.kind not in "fiu":
        raise ConfigurationError(f"command: expected numbers, got an array of {given.dtype}")
    return given.astype(np.float64)


def _warn(text: str) -> None:
    # `warned` marks the log line, so that a terminal does not show the warning twice
    _LOG.warning("%s", text, extra={"warned": True}, stacklevel=2)
    warnings.warn(text, VergenceWarning, stacklevel=3)
