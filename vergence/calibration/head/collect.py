"""Collect the poses of a head calibration: plan, look, judge, and preview what they determine."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, product
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from vergence.calibration.head.calibrate import CalibrationPreview, preview_calibration
from vergence.calibration.head.fit import board_corners_and_poses_in_base
from vergence.calibration.head.judge import refuse_fixed_eyes
from vergence.calibration.head.recording import (
    AT_REST,
    HEAD_IDENTITY,
    PLACEMENT,
    SUFFIX,
    TARGET,
    HeadFrames,
    clean_and_renumber_frames,
    list_logs,
    read_logs,
    refuse_unknown_size,
)
from vergence.errors import ConfigurationError
from vergence.files import hold_lock
from vergence.models.head import HeadModel
from vergence.models.parts import EYE_NAMES, EYES, NECK, FloatArray
from vergence.perception.locate import equivalent_corner_orders
from vergence.recording.events import BoardView, Looker
from vergence.recording.schema import LoggedDetection
from vergence.recording.writer import LogWriter

_CANDIDATES: Final = 400
"""Random postures from which the next one is chosen (chosen: more take longer)."""
_MARGINS: Final = (0.1, 0.05, 0.02)
"""Margins around the board in the image, in image widths, tried in this order (chosen: a head that
is not yet calibrated may look some degrees beside, each about 9 px of 640)."""
_KNOWN_MARGINS: Final = (0.025, 0.015)
"""Margins once the head is known well, in image widths (chosen: room for the detector)."""
_FARTHEST_NECK_RAD: Final = 0.6
"""Largest angle of a neck joint from rest, rad (chosen: the eyes can compensate for it, and it is
moderate for a resting body)."""
_EYE_OFFSET_RAD: Final = 0.1
"""Largest random offset of an eye actuator from the fixation of one point, rad (chosen)."""
_LIMIT_DISTANCE_RAD: Final = 1e-3
"""Distance of actuators to their limits, beyond the dither, rad (chosen)."""
_NECK_WEIGHT: Final = 0.5
"""Weight of the neck's whole range relative to the board crossing the whole image (chosen)."""


class EstimatedBoard(NamedTuple):
    """A head model, and the corners of the board in frame 0 as each eye of that head sees them."""

    head: HeadModel
    """The estimated head."""
    corners_by_eye: FloatArray
    """(2, n, 3) the board's corners in frame 0, m, as seen by each eye of that head."""
    is_fitted: bool
    """True if head and corners come from a fit to many views."""

    def pixels(self, q: FloatArray) -> FloatArray:
        """(..., 2, n, 2) predicted corners in both eyes at joint angles (..., 7), px."""
        T_0_N = self.head.base_pose(q)[..., None, :, :]
        found = []
        for eye, corners in enumerate(self.corners_by_eye):
            inside = (corners - T_0_N[..., :3, 3]) @ T_0_N[..., 0, :3, :3]
            found.append(self.head.project(q[..., None, :], inside)[..., eye, :])
        return np.stack(found, axis=-3)


def estimate_board_by_last_views(head: HeadModel, frames: HeadFrames) -> EstimatedBoard:
    """Board by the last view of each eye, whose error recurs in its next; else the other's."""
    places, _, _ = board_corners_and_poses_in_base(head, frames)
    last = [corners[shown][-1:] for corners, shown in zip(places, frames.shown, strict=True)]
    left, right = (own if len(own) else other for own, other in (last, last[::-1]))
    return EstimatedBoard(head, np.concatenate([left, right]), False)


def _clipped(head: HeadModel, actuators: FloatArray, keep_rad: float = 0.0) -> FloatArray:
    """Joint angles of actuators, clipped at some distance from their limits."""
    own = head.actuation
    keep = np.minimum(keep_rad, 0.5 * (own.upper - own.lower))
    return own.joints_of(np.clip(np.nan_to_num(actuators), own.lower + keep, own.upper - keep))


class PosePlanner:
    """Chooser of postures unlike (k, 7) earlier ones, with a dither of each actuator, rad."""

    def __init__(self, rng: np.random.Generator, dither_rad: float, used: FloatArray) -> None:
        self._rng, self._keep = rng, dither_rad + _LIMIT_DISTANCE_RAD
        self._used = list(used)
        self._scene: EstimatedBoard | None = None
        self._features: list[FloatArray] = []

    def next_pose(self, scene: EstimatedBoard) -> FloatArray:
        """(7,) rad, most different from earlier postures, the board inside both images."""
        size, q = scene.head.cameras.size[:, None], self._candidates(scene)
        pixels = scene.pixels(q)
        for margin in _KNOWN_MARGINS if scene.is_fitted else _MARGINS:
            room = margin * size[..., :1]
            inside = ((pixels > room) & (pixels < size - 1.0 - room)).all(axis=(1, 2, 3))
            if inside.any():
                return self._farthest(scene, q[inside], pixels[inside])
        raise ConfigurationError(
            "expected a board that fits into both images at once, got one that does not, however "
            "the head turns: put it farther away, or before the middle of the head"
        )

    def _candidates(self, scene: EstimatedBoard) -> FloatArray:
        """(k, 7) random joint angles with the board somewhere near both images."""
        rng, head = self._rng, scene.head
        own, rest = head.actuation, head.rest()
        neck = rest[NECK] + rng.uniform(-1.0, 1.0, (_CANDIDATES, 3)) * _FARTHEST_NECK_RAD
        neck = np.clip(neck, own.lower[NECK], own.upper[NECK])
        T_0_N = head.base_pose(np.pad(neck, ((0, 0), (0, 4))))
        middle = scene.corners_by_eye.mean(axis=(0, 1))
        there = np.einsum("kji,kj->ki", T_0_N[:, :3, :3], middle - T_0_N[:, :3, 3])
        half_view = 0.5 * head.cameras.size.min(axis=0) / head.cameras.focal.max(axis=0)
        aside = rng.uniform(-1.0, 1.0, (_CANDIDATES, 2)) * half_view
        there[:, :2] += aside * np.linalg.norm(there, axis=-1, keepdims=True)
        q = own.actuators_of(np.nan_to_num(head.fixate(there, neck)))
        q[:, EYES] += rng.uniform(-_EYE_OFFSET_RAD, _EYE_OFFSET_RAD, (_CANDIDATES, 4))
        return _clipped(head, q, self._keep)

    def _farthest(self, scene: EstimatedBoard, q: FloatArray, pixels: FloatArray) -> FloatArray:
        """Use the posture farthest from the nearest used one, by `_features`."""
        known = self._scene
        if self._used and not (
            known is not None
            and known.head is scene.head
            and np.array_equal(known.corners_by_eye, scene.corners_by_eye)
        ):
            used = np.array(self._used)
            self._features = list(_features(scene, used, scene.pixels(used)))
        self._scene, features, best = scene, _features(scene, q, pixels), 0
        if self._used:
            away = features[:, None] - np.array(self._features)
            best = int(np.linalg.norm(away, axis=-1).min(axis=1).argmax())
        self._used.append(q[best])
        self._features.append(features[best])
        return np.asarray(q[best])


def _features(scene: EstimatedBoard, q: FloatArray, pixels: FloatArray) -> FloatArray:
    """(k, 7) features to compare postures: the board's position in both images, and the neck."""
    places = np.nan_to_num(pixels.mean(axis=-2) / scene.head.cameras.size)
    neck = _NECK_WEIGHT / (2.0 * _FARTHEST_NECK_RAD) * q[:, NECK]
    return np.concatenate([places.reshape(len(q), -1), neck], axis=-1)


_DITHER_RAD: Final = np.deg2rad(0.3).item()
"""Largest dither of an actuator about a pose, rad (chosen: several quantisation steps of a 12-bit
encoder, which makes their errors independent, and small enough to keep the board in view)."""
_POSES_PER_EVALUATION: Final = 10
"""Poses after which the recording is evaluated again (chosen: a fit takes time)."""
_MOST_LOST_POSES: Final = 12
"""Consecutive poses without the board after which the collection ends with an error (chosen)."""
_LOOKS_BEFORE_GIVING_UP: Final = 2
"""Looks of a pose without the board after which the next pose is tried (chosen)."""
_MOVED_WIDTHS: Final = 0.01
"""Displacement of the board in the image, in image widths, above which the board has been moved
(chosen: a fit to ten poses predicts it to a pixel or two)."""
_AZIMUTHS: Final = np.deg2rad((-50.0, -25.0, 0.0, 25.0, 50.0))
"""Azimuths to look at, rad (chosen: common cameras have 50 to 60 degrees field of view)."""
_ELEVATIONS: Final = np.deg2rad((-25.0, 0.0, 25.0))
"""Elevations to look at, rad (chosen, see `_AZIMUTHS`)."""
_NECK_SHARES: Final = (0.0, -0.6, 0.6)
"""Fractions of the way from rest to a limit for the neck's first and last joint (chosen)."""
_SAME_POSTURE_RAD: Final = 0.02
"""Largest joint difference of two postures that count as equal, rad (chosen)."""
_AHEAD_M: Final = 1.0
"""Forward distance of the fixated points, m (chosen)."""


@dataclass(frozen=True, kw_only=True)
class CollectOptions:
    """Options of a collection."""

    poses: int = 60
    """Poses per placement of the board, including those of earlier runs."""
    frames: int = 8
    """Frames per pose, each with all joints dithered."""
    seed: int = 0
    """Seed of the postures; every run in a folder has its own random stream."""
    until: float | None = None
    """Depth uncertainty, in per cent, at which the collection ends; None for all poses."""
    moved: bool = False
    """True if the board has been moved since the last run in this folder."""

    def __post_init__(self) -> None:
        for name, value, most in (("poses", self.poses, 10_000), ("frames", self.frames, 100)):
            if not 1 <= value <= most:
                raise ConfigurationError(f"{name}: expected 1 to {most}, got {value}")
        if self.seed < 0:
            raise ConfigurationError(f"seed: expected a whole number from 0 on, got {self.seed}")
        if self.until is not None and not self.until > 0.0:
            raise ConfigurationError(f"until: expected a percentage above 0, got {self.until}")

    def reached_by(self, found: "CollectedRecording") -> bool:
        """True if a recording is complete."""
        if found.poses >= self.poses:
            return True
        if self.until is None or found.preview is None or found.poses < _POSES_PER_EVALUATION:
            return False
        return bool(found.preview.depth_percent.max() <= self.until)


@dataclass
class CollectedRecording:
    """Content of a recording so far."""

    folder: Path
    placement: int = 0
    """Number of the board's present placement."""
    parts: list[HeadFrames] = field(default_factory=list)
    """Frames of earlier runs, and of each pose, with times one after the other."""
    poses: int = 0
    """Poses of the present placement, including those of earlier runs."""
    looks_without_board: int = 0
    """Looks of this run in which neither eye saw the board."""
    preview: CalibrationPreview | None = None
    """Preliminary calibration from the recording; None while there is none."""

    @property
    def is_placed(self) -> bool:
        """True if frames show the board at its present placement."""
        return any((part.placement == self.placement).any() for part in self.parts)

    def frames(self) -> HeadFrames:
        """All frames in the order of time."""
        return clean_and_renumber_frames(HeadFrames.joined(self.parts))


def collect(
    looker: Looker,
    folder: Path,
    options: CollectOptions,
    log_facts: Mapping[str, str],
    *,
    progress: Callable[[float], None] = lambda fraction: None,
    on_evaluation: Callable[[CollectedRecording], None] = lambda found: None,
) -> CollectedRecording:
    """Make a recording, or continue one: a new log with `log_facts` joins those of the folder.

    Raises:
        VergenceError: there is no board, it has been moved, or the head fails; earlier frames are
            kept.
    """
    refuse_fixed_eyes(looker.head)
    refuse_unknown_size(looker.target)
    with hold_lock(folder):
        found, number = _earlier(looker, folder, options.moved, log_facts.get(HEAD_IDENTITY, ""))
        if not options.reached_by(found):
            _Run(looker, options, found, number).go(log_facts, progress, on_evaluation)
    return found


def _earlier(
    looker: Looker, folder: Path, moved: bool, head_identity: str
) -> tuple[CollectedRecording, int]:
    """Read the recording that a folder already holds, and number its next log."""
    if folder.exists() and not folder.is_dir():
        raise ConfigurationError(f"{folder}: expected a folder, got a file")
    logs = list_logs(folder) if any(folder.glob(f"*{SUFFIX}")) else []
    number = 1 + max((int(log.stem) for log in logs if log.stem.isdecimal()), default=0)
    found = CollectedRecording(folder)
    if logs:
        before = read_logs(logs, looker.head, looker.target)
        if before.head_identity != head_identity:
            raise ConfigurationError(
                f"{folder}: expected the head that it holds frames of "
                f"({before.head_identity.strip()}), got another ({head_identity.strip()}): "
                "other --plant, --errors or --seed"
            )
        if len(before.frames.time_s):
            found.parts.append(before.frames)
            found.placement = int(before.frames.placement.max()) + moved
        frames = clean_and_renumber_frames(before.frames)
        if found.is_placed:
            own = frames.placement == len(np.unique(before.frames.placement)) - 1
            found.poses = len(np.unique(frames.pose[own]))
        if len(np.unique(frames.pose)) >= _POSES_PER_EVALUATION:
            found.preview = preview_calibration(looker.head, frames)
    return found, number


class _Run:
    """One run of a collection, with a log of its own."""

    def __init__(
        self, looker: Looker, options: CollectOptions, found: CollectedRecording, number: int
    ) -> None:
        self._looker, self._options, self._found, self._number = looker, options, found, number
        self._rng = np.random.default_rng([options.seed, number])
        earlier = HeadFrames.joined([*found.parts, HeadFrames.of_views(looker.target, [], [])])
        used = earlier.joint_positions[earlier.placement == found.placement]
        self._plan = PosePlanner(self._rng, _DITHER_RAD, used)
        # the board is most likely visible again from an earlier posture
        self._first = self._last = find_board(looker, [looker.head.rest(), *used[-1:]])
        self._refuse_moved(self._last)
        # a looker's clock restarts, but the frames of this run come after all others
        ended_s = float(earlier.time_s.max(initial=0.0))
        self._later_s = ended_s + 1.0 - float(self._last.time_s[0])

    def go(
        self,
        facts: Mapping[str, str],
        progress: Callable[[float], None],
        evaluated: Callable[[CollectedRecording], None],
    ) -> None:
        """Record poses until there are enough, see `collect`."""
        looker, options, found = self._looker, self._options, self._found
        facts = {
            TARGET: str(looker.target), PLACEMENT: str(found.placement), AT_REST: str(True), **facts
        }  # fmt: skip
        path = found.folder / f"{self._number:04d}{SUFFIX}"
        lost = 0
        with LogWriter(path, head=looker.head, facts=facts) as log:
            while not options.reached_by(found):
                if not self._pose(log):
                    lost += 1
                    if lost == _MOST_LOST_POSES:
                        raise ConfigurationError(
                            f"expected {looker.target} where it was, found it in none of the last "
                            f"{lost} poses: has it been moved (--moved), or covered?"
                        )
                    continue
                lost, found.poses = 0, found.poses + 1
                if found.poses % _POSES_PER_EVALUATION == 0 or found.poses == options.poses:
                    known = preview_calibration(looker.head, found.frames(), found.preview)
                    found.preview = known or found.preview
                    evaluated(found)
                progress(found.poses / options.poses)

    def _pose(self, log: LogWriter) -> bool:
        """Record the next pose; return True if the board was seen."""
        looker, found, own = self._looker, self._found, self._looker.head.actuation
        scene = self._fitted_board() or estimate_board_by_last_views(looker.head, self._last)
        base = own.actuators_of(self._plan.next_pose(scene))
        kept: list[BoardView] = []
        for number in range(self._options.frames):
            dither = self._rng.uniform(-_DITHER_RAD, _DITHER_RAD, 7) * (own.upper > own.lower)
            view = looker.look(_clipped(looker.head, base + dither))
            if HeadFrames.of_views(looker.target, [view], [0]).shown.any():
                _keep(log, view)
                kept.append(view)
            else:
                found.looks_without_board += 1
            if number + 1 == _LOOKS_BEFORE_GIVING_UP and not kept:
                break
        self._last = self._first  # the last detection may have been a wrong one
        if kept:
            places = [found.placement] * len(kept)
            self._last = HeadFrames.of_views(looker.target, kept, places)
            found.parts.append(replace(self._last, time_s=self._last.time_s + self._later_s))
        return bool(kept)

    def _fitted_board(self) -> EstimatedBoard | None:
        """Get the board's position by the fit to all frames; None if this placement has none."""
        found = self._found
        if found.preview is None or not found.is_placed:
            return None
        boards = found.preview.boards
        place = len({int(place) for part in found.parts for place in part.placement}) - 1
        if place >= len(boards.translation):
            return None
        corners = self._last.corners @ boards.rotation[place].T + boards.translation[place]
        return EstimatedBoard(found.preview.head, np.stack([corners, corners]), True)

    def _refuse_moved(self, frame: HeadFrames) -> None:
        """Refuse a board that is not where earlier frames of its placement show it."""
        fitted_board, looker = self._fitted_board(), self._looker
        if fitted_board is None:
            return
        expected, seen = fitted_board.pixels(frame.joint_positions[0]), frame.pixels[:, 0]
        # a rotationally symmetric board may be detected in any of its corner orders
        orders = equivalent_corner_orders(looker.target)
        away = min(float(np.nanmax(np.abs(seen[:, order] - expected))) for order in orders)
        if away > _MOVED_WIDTHS * looker.head.cameras.size.max():
            raise ConfigurationError(
                f"expected {looker.target} where the frames in {self._found.folder} have it, "
                f"found it {away:.0f} px away: has it been moved (--moved)?"
            )


def _keep(log: LogWriter, view: BoardView) -> None:
    """Write a view to the log and to disk."""
    unknown, (time_s, positions, corners, sigmas) = np.full(2, np.nan), view
    for name, *seen in zip(EYE_NAMES, corners, sigmas, strict=True):
        found = (np.empty((0, 2)) if each is None else each for each in seen)
        log.detection(LoggedDetection(name, time_s, time_s, positions, unknown, unknown, *found))
    log.sync()
    if log.fault:
        raise ConfigurationError(log.fault)


def find_board(looker: Looker, first_guesses: Sequence[FloatArray] = ()) -> HeadFrames:
    """Look around, at guesses (7,) first, until an eye sees the board; one frame of both eyes."""
    head, looks = looker.head, 0
    for q in chain(first_guesses, _directions(head)):
        looks += 1
        frame = HeadFrames.of_views(looker.target, [looker.look(q)], [0])
        if frame.shown.all():
            return frame
        if frame.shown.any():  # turn both eyes to the board that one of them has seen
            T_0_N = head.base_pose(frame.joint_positions[0])
            middle = estimate_board_by_last_views(head, frame).corners_by_eye.mean(axis=(0, 1))
            inside = T_0_N[:3, :3].T @ (middle - T_0_N[:3, 3])
            turned = head.fixate(inside, frame.joint_positions[0, :3], warn=False)
            view = looker.look(_clipped(head, head.actuation.actuators_of(turned)))
            again = HeadFrames.of_views(looker.target, [view], [0])
            return again if again.shown.any() else frame
    raise ConfigurationError(
        f"expected {looker.target} where the eyes can look, found it in no direction of {looks}: "
        "is it that target, whole, flat, upright, well lit, and neither too near nor too far?"
    )


def _directions(head: HeadModel) -> Iterator[FloatArray]:
    """Generate (7,) joint angles for all directions, nearest to rest first."""
    own, rest = head.actuation, head.rest()
    found = [rest]
    for yaw, pitch in product(_NECK_SHARES, _NECK_SHARES):
        neck = rest[:3].copy()
        for joint, share in ((0, yaw), (2, pitch)):
            limit = (own.upper if share > 0.0 else own.lower)[joint]
            neck[joint] += abs(share) * (limit - neck[joint])
        for azimuth, elevation in product(_AZIMUTHS, _ELEVATIONS):
            point = _AHEAD_M * np.array([np.tan(azimuth), np.tan(elevation), 1.0])
            q = head.fixate(point, neck, warn=False)
            found.append(_clipped(head, own.actuators_of(q)))
    found.sort(key=lambda q: float(np.abs(q - rest).sum()))
    taken: list[FloatArray] = []
    for q in found:
        if all(np.abs(q - one).max() > _SAME_POSTURE_RAD for one in taken):
            taken.append(q)
            yield q


_CELLS: Final = 4
"""Cells along each side of an image in which coverage is counted (chosen)."""
_ENOUGH_COVERAGE_PERCENT: Final = 80.0
"""Percentage of cells that is enough coverage (chosen)."""
_UNMOVED_RANGE_RAD: Final = 0.1
"""Range of angles up to which a joint counts as unmoved, rad (chosen: 6 degrees)."""
_FAR_M: Final = 1.5
"""Distance of a board that is far enough to calibrate depth far away, m (chosen)."""


def image_coverage_percent(head: HeadModel, frames: HeadFrames) -> FloatArray:
    """(2,) by eye, percentage of the cells of the image that have had a corner."""
    found = []
    for eye in range(2):
        seen = frames.pixels[eye][frames.seen[eye]]
        cell = np.clip(_CELLS * (seen + 0.5) / head.cameras.size[eye], 0, _CELLS - 1).astype(int)
        found.append(100.0 * len(np.unique(cell, axis=0)) / _CELLS**2)
    return np.array(found)


def advise_recording(
    head: HeadModel, recording: CollectedRecording, frames: HeadFrames
) -> list[str]:
    """Advise how to make the recording more informative, a line each."""
    lines = []
    there = np.array([bool(name) for name in head.joints[NECK]])
    ranges = np.ptp(frames.joint_positions[:, NECK], axis=0)
    if there.any() and not (ranges[there] > _UNMOVED_RANGE_RAD).any():
        lines.append(
            "the neck has not moved: where the eyes sit in the neck stays as it was believed"
        )
    if not frames.placement.any():
        lines.append(
            "the board stood in one place: put it at another distance, and run this again with "
            "--moved"
        )
    if recording.preview is not None:
        eyes = (head.base_pose(head.rest()) @ head.camera_poses(head.rest()))[:, :3, 3].mean(axis=0)
        away = np.linalg.norm(recording.preview.boards.translation - eyes, axis=-1)
        if away.max() < _FAR_M:
            lines.append(
                f"the board was never farther than {away.max():.2g} m: one beyond {_FAR_M:g} m "
                "determines depth far away better"
            )
    for eye, percent in zip(EYE_NAMES, image_coverage_percent(head, frames), strict=True):
        if percent < _ENOUGH_COVERAGE_PERCENT:
            lines.append(f"the board was seen in {percent:.0f} % of the {eye} image alone")
    return lines
