"""What a head calibration works on: frames at joint angles, from photographs or a robot's log."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vergence.calibration.observations import alike_views, detect_board_corners, parse_board
from vergence.errors import ConfigurationError, UnreadableFileError
from vergence.models.head import HeadModel
from vergence.models.parts import EYE_NAMES, NECK, FloatArray
from vergence.perception.photographs import (
    Row,
    join_first_names,
    natural_sort_key,
    pair_up,
    parse_finite_number,
    parse_joint_angles,
    read_pair_rows,
)
from vergence.recording.events import BoardView
from vergence.recording.log import Log, read_log
from vergence.recording.schema import LoggedDetection
from vergence.triangulation import Noise
from vergence.vision.targets import PlanarTarget

IntArray = NDArray[np.intp]
SAME_POSE_RAD: Final = 0.026
"""Bound on the difference of frames of one pose in every joint, rad (chosen: 1.5 degrees, between
the dither of some tenths of a degree and the distance of poses of some degrees)."""
_STILL_POSE_FRACTION: Final = 0.8
"""Fraction of the poses in which a joint's reading must not change for the joint to count as one
without dither (chosen)."""
_FRAME_AXES: Final = {
    "time_s": 0, "joint_positions": 0, "pixels": 1, "sigma": 1, "placement": 0
}  # fmt: skip
"""Axis of the frames in each array of `HeadFrames`."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HeadFrames:
    """Frames of a head in front of a board, in the order of time."""

    target: PlanarTarget
    time_s: FloatArray
    """(f,) times of the exposures, s."""
    joint_positions: FloatArray
    """(f, 7) joint angles that were read, rad."""
    pixels: FloatArray
    """(2, f, n, 2) raw pixels of the board's corners by eye; nan for those that were not found."""
    sigma: FloatArray
    """(2, f, n, 2) their standard deviations, px."""
    placement: IntArray
    """(f,) number of the board's placement in frame 0, from 0 on: a change means that the board was
    moved."""

    @classmethod
    def of_views(
        cls, target: PlanarTarget, views: Sequence[BoardView], placement: Sequence[int]
    ) -> "HeadFrames":
        """Pack views in their order; corners without a pixel or a sigma count as not found."""
        count = len(views)
        pixels = np.full((2, count, len(target.corners_m), 2), np.nan)
        sigma = np.full(pixels.shape, np.nan)
        for frame, view in enumerate(views):
            for eye in range(2):
                found, deviation = view.corners_px[eye], view.sigma_px[eye]
                if found is not None and deviation is not None:
                    pixels[eye, frame], sigma[eye, frame] = found, deviation
        known = (np.isfinite(pixels) & np.isfinite(sigma) & (sigma > 0.0)).all(axis=-1)
        pixels[~known] = sigma[~known] = np.nan
        return cls(
            target=target, time_s=np.array([view.time_s for view in views], dtype=np.float64),
            joint_positions=np.array([view.positions for view in views]).reshape(count, 7),
            pixels=pixels, sigma=sigma, placement=np.array(placement, dtype=np.intp),
        )  # fmt: skip

    @classmethod
    def joined(cls, parts: Sequence["HeadFrames"]) -> "HeadFrames":
        """Join frames of one target, one after the other."""
        return cls(
            target=parts[0].target,
            **{
                name: np.concatenate([getattr(part, name) for part in parts], axis=axis)
                for name, axis in _FRAME_AXES.items()
            },
        )

    def select(self, frames: NDArray[np.bool_] | IntArray) -> "HeadFrames":
        """Select some of the frames."""
        chosen = {
            name: getattr(self, name)[(slice(None),) * axis + (frames,)]
            for name, axis in _FRAME_AXES.items()
        }
        return replace(self, **chosen)

    @cached_property
    def corners(self) -> FloatArray:
        """(n, 3) the board's corners relative to their middle, metres."""
        flat = np.column_stack([self.target.corners_m, np.zeros(len(self.target.corners_m))])
        return np.asarray(flat - flat.mean(axis=0))

    @property
    def size_m(self) -> float:
        """Length of the board, m."""
        return float(np.ptp(self.corners, axis=0).max())

    @cached_property
    def seen(self) -> NDArray[np.bool_]:
        """(2, f, n) True for corners that were found."""
        return np.asarray(np.isfinite(self.pixels).all(axis=-1))

    @cached_property
    def shown(self) -> NDArray[np.bool_]:
        """(2, f) True for views with enough corners to determine the board's pose."""
        return np.asarray(self.seen.sum(axis=-1) >= LEAST_CORNERS)

    @cached_property
    def pose(self) -> IntArray:
        """(f,) number of the pose that each frame belongs to, see `SAME_POSE_RAD`."""
        numbers, first, q = np.zeros(len(self.time_s), dtype=np.intp), 0, self.joint_positions
        for frame in range(1, len(numbers)):
            near = np.abs(q[frame] - q[first]).max() < SAME_POSE_RAD
            if not (near and self.placement[frame] == self.placement[first]):
                numbers[frame:] += 1
                first = frame
        return numbers


@dataclass(frozen=True, eq=False)
class ReadingErrorUnknowns:
    """Layout of errors: each angle of each frame has its own, shares one, or has none."""

    actuator_readings: FloatArray
    """(f, 7) actuator angles that were read, rad; the mean reading for resting joints."""
    reading_sigma: FloatArray
    """(7,) standard deviation of a reading, rad."""
    has_frame_error: NDArray[np.bool_]
    """(f, 7) True for angles with an error of the single frame."""
    shared_error_index: IntArray
    """(f, 7) index of the error that frames share; -1 for none."""
    shared_error_actuator: IntArray
    """(r,) actuator of each shared error."""

    @classmethod
    def of(cls, head: HeadModel, frames: HeadFrames) -> "ReadingErrorUnknowns":
        """Unknown reading errors of frames in time, by the head's quantisation and backlash."""
        own = head.actuation
        angles = own.actuators_of(frames.joint_positions)
        sigma = np.asarray(Noise.of(head).joint_rad)
        step = np.maximum(own.angle_step, own.backlash)
        moves = np.asarray(own.upper > own.lower) & (sigma > 0.0)
        free = np.broadcast_to(moves, angles.shape).copy()
        shared_index = np.full(angles.shape, -1, dtype=np.intp)
        shared_actuator: list[int] = []
        resting: list[int] = []
        for joint in np.flatnonzero(moves).tolist():
            if joint < NECK.stop and all(
                np.ptp(angles[frames.placement == place, joint]) <= step[joint]
                for place in np.unique(frames.placement)
            ):
                free[:, joint] = False  # its error only shifts the board's unknown pose
            elif _rests(angles[:, joint], frames.pose, step[joint]):
                resting.append(joint)
        # a joint whose reading stays while others change may have moved within its step
        stretches = _stretches(angles[:, resting], step[resting], frames.placement)
        for joint in resting:
            free[:, joint] = False
            for begin, end in stretches:
                shared_index[begin:end, joint] = len(shared_actuator)
                shared_actuator.append(joint)
                angles[begin:end, joint] = angles[begin:end, joint].mean()
        return cls(angles, sigma, free, shared_index, np.array(shared_actuator, dtype=np.intp))


def _rests(angles: FloatArray, pose: IntArray, step: float) -> bool:
    """Return True if a joint's reading stays within a step in most poses of several frames."""
    poses = np.flatnonzero(np.bincount(pose) > 1)
    still = [np.ptp(angles[pose == each]) <= _SAME_READING_STEPS * step for each in poses]
    return bool(still) and float(np.mean(still)) >= _STILL_POSE_FRACTION


def _stretches(angles: FloatArray, step: FloatArray, placement: IntArray) -> list[tuple[int, int]]:
    """Split the frames into runs in which all readings stay within a step."""
    found, begin = [], 0
    for frame in range(1, len(angles) + 1):
        if frame < len(angles) and placement[frame] == placement[begin]:
            stretch = angles[begin : frame + 1]
            if (np.ptp(stretch, axis=0) <= _SAME_READING_STEPS * step).all():
                continue
        found.append((begin, frame))
        begin = frame
    return found


_SAME_READING_STEPS: Final = 1.01
"""Steps (quantisation or backlash) within which readings count as equal: one, for an angle at the
edge of a step, and rounding (numerical)."""


MOST_PLACES: Final = 1000
"""Bound on the numbers of the board's placements (chosen: larger ones are times or names)."""
AT_REST: Final = "at_rest"
"""Name of a log's fact that is `True` if every image was taken at rest."""
HEAD_IDENTITY: Final = "looks"
"""Name of a log's fact that distinguishes heads with the same file."""
PLACEMENT: Final = "placement"
"""Name of a log's fact, and of a column of a table, with the number of the board's placement."""
TARGET: Final = "target"
"""Name of a log's fact with the board, in the form of `parse_target`."""
SUFFIX: Final = ".mcap"
"""File suffix of a log."""
TABLES: Final = ("joints.csv", "joints.json", "joints.toml")
"""File names of the table of joint angles of photographs."""
_TIME_COLUMN: Final = "time_s"
LEAST_CORNERS: Final = 4
"""Fewest corners of a view (physical: geometry, fewer do not determine the board's pose)."""
_LOG_GAP_S: Final = 1.0
"""Time from the last frame of a log to the first of the next one, s (chosen: clocks may have been
set between them, so that their own times cannot be used)."""
_REST_WINDOW_S: Final = 0.15
"""Time before and after an exposure in which a joint at rest must not move, s (chosen: backlash and
brackets have settled then)."""
_STILL_RAD_S: Final = 0.02
"""Speed of a joint up to which it counts as at rest, rad/s (chosen: with 5 ms between an image and
its angles it causes 0.1 mrad, a fifteenth of a 12-bit encoder's step)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HeadRecording:
    """A recording of a head in front of a board."""

    frames: HeadFrames
    """Its frames; `read_recording` has them in the order of time, at least one, with placements of
    the board that are numbered without gaps."""
    files: tuple[str, ...]
    """Names of the files that it was read from."""
    remarks: tuple[str, ...]
    """Remarks on data that was left out or does not quite fit, a line each."""
    read_errors: tuple[str, ...]
    """Files that could not be read, a line each."""
    head_identity: str = ""
    """Identity of the head that looked, if the logs distinguish heads with the same file."""

    @property
    def sha256(self) -> str:
        """Digest of board, corners, joint angles and placements; rounded to 1e-6 px, 1e-9 rad."""
        frames = self.frames
        sha = hashlib.sha256(str(frames.target).encode())
        for values, digits in ((frames.pixels, 6), (frames.sigma, 6), (frames.joint_positions, 9)):
            # adding 0 makes -0 positive
            rounded = np.round(np.nan_to_num(values, nan=-1.0), digits) + 0.0
            sha.update(rounded.astype("<f8").tobytes())
        sha.update(frames.placement.astype("<i8").tobytes())
        return sha.hexdigest()


def read_recording(
    path: Path,
    head: HeadModel,
    target: PlanarTarget | None = None,
    progress: Callable[[float], None] | None = None,
) -> HeadRecording:
    """Read a recording of a head in front of a board.

    Args:
        path: a robot's log, a folder of such logs, which follow each other in the order of their
            names, or a folder with the photographs of both eyes in `left` and `right` and their
            joint angles in `joints.csv`, `.json` or `.toml`.
        head: the nominal head, from its file.
        target: the board; None for the board named in the logs.
        progress: called with the fraction done.

    Raises:
        VergenceError: it is no recording of that head and that board; the message says why.
    """
    if not path.exists():
        raise ConfigurationError(f"{path}: no such file or folder; expected a recording")
    if path.is_dir() and any((path / eye).is_dir() for eye in EYE_NAMES):
        found = _read_photographs(path, head, target, progress)
    else:
        found = read_logs(list_logs(path), head, target, progress)
    board, count = found.frames.target, len(found.frames.time_s)
    refuse_unknown_size(board)
    frames = clean_and_renumber_frames(found.frames)
    if not len(frames.time_s):
        raise ConfigurationError(f"{path}: expected frames that show {board}, got none in {count}")
    remarks = found.remarks
    if len(frames.time_s) < count:
        remarks += (
            f"{count - len(frames.time_s)} of {count} frames left out: "
            "they do not show the board, or repeat an earlier frame",
        )
    return replace(found, frames=frames, remarks=remarks)


def refuse_unknown_size(target: PlanarTarget) -> None:
    """Refuse a board without a size."""
    if not target.size_known:
        raise ConfigurationError(
            f"target: expected a size in mm, which all lengths come from, got {target}"
        )


def clean_and_renumber_frames(frames: HeadFrames) -> HeadFrames:
    """Tidy frames, see `sort_and_clean_frames`, and number the board's placements without gaps."""
    frames = sort_and_clean_frames(frames)
    places = np.unique(frames.placement, return_inverse=True)[1]
    return replace(frames, placement=places.astype(np.intp))


def sort_and_clean_frames(frames: HeadFrames) -> HeadFrames:
    """Sort frames by time; leave out those without the board, and all but one of a head at rest."""
    frames = frames.select(np.argsort(frames.time_s, kind="stable"))
    shown = np.asarray(frames.shown.any(axis=0))
    fresh = np.ones(len(shown), bool)
    same = np.unique(frames.joint_positions, axis=0, return_inverse=True)[1].ravel()
    for group in np.flatnonzero(np.bincount(same) > 1):
        here = np.flatnonzero(same == group)
        fresh[here[list(alike_views(frames.pixels[:, here], frames.sigma[:, here]))]] = False
    return frames.select(shown & fresh)


def list_logs(path: Path) -> list[Path]:
    """List a log, or the logs directly in a folder, in the order of their names."""
    if not path.is_dir():
        return [path]
    found = sorted((one for one in path.iterdir() if one.suffix == SUFFIX), key=natural_sort_key)
    if not found:
        raise ConfigurationError(
            f"{path}: expected logs of a robot (*{SUFFIX}) in it, or the folders left and right "
            "with photographs, got neither"
        )
    return found


def read_logs(
    paths: Sequence[Path],
    head: HeadModel,
    target: PlanarTarget | None,
    progress: Callable[[float], None] | None = None,
) -> HeadRecording:
    """Read all frames of logs, one after the other; by default of the board they name."""
    views: list[BoardView] = []
    placement: list[int] = []
    files, failures = [], []
    looked: dict[str, str] = {}
    begins_s, moving, unlike, cut = 0.0, 0, 0, 0
    for number, path in enumerate(paths, 1):
        try:
            log = read_log(path)
        except UnreadableFileError as error:
            if len(paths) == 1:
                raise
            failures.append(str(error))
            continue
        target = _target_of(log, target)
        _refuse_other_joints(log, head)
        looked.setdefault(log.facts.get(HEAD_IDENTITY, ""), path.name)
        if len(looked) > 1:
            first, second = looked.values()
            raise ConfigurationError(
                f"{path.parent}: expected logs of one head, got {first} and {second} of different "
                "ones: other --plant, --errors or --seed"
            )
        files.append(path.name)
        found, moved = _board_views(log, head, target)
        text = log.facts.get(PLACEMENT, "0")
        place = _placement(text, float(text) if text.isdecimal() else -1.0, str(path))
        if found:
            views += [one._replace(time_s=one.time_s - found[0].time_s + begins_s) for one in found]
            placement += [place] * len(found)
            begins_s = views[-1].time_s + _LOG_GAP_S
        moving += moved
        unlike += log.head.digest != head.digest
        cut += bool(log.truncation_reason)
        if progress is not None:
            progress(number / len(paths))
    if target is None or not files:
        raise ConfigurationError(f"expected logs that can be read, got none; {failures[0]}")
    remarks = {
        f"{moving} images left out, as joints were moving": moving,
        f"{unlike} of {len(files)} logs: the head had other numbers than {head.name}": unlike,
        f"{cut} of {len(files)} logs are cut off: read up to there": cut,
    }
    return HeadRecording(
        frames=HeadFrames.of_views(target, views, placement), files=tuple(files),
        remarks=tuple(line for line, count in remarks.items() if count),
        read_errors=tuple(failures), head_identity=next(iter(looked)),
    )  # fmt: skip


def _target_of(log: Log, target: PlanarTarget | None) -> PlanarTarget:
    """Get the board of a log; refuse one that differs from the expected board."""
    if not log.facts.get(TARGET):
        if target is None:
            raise ConfigurationError(
                f"{log.path}: expected the board among the log's facts, or as --target, got neither"
            )
        return target
    try:
        own = parse_board(log.facts[TARGET], accept_single_tag=True)
    except ConfigurationError as error:
        raise ConfigurationError(f"{log.path}: {error}") from error
    if target is not None and str(own) != str(target):
        raise ConfigurationError(f"{log.path}: target: expected {target}, got a log of {own}")
    return own


def _placement(raw: object, number: float, where: str) -> int:
    """Check the number of a placement, which a file gives as `raw`."""
    if not (number.is_integer() and 0 <= number < MOST_PLACES):
        raise ConfigurationError(
            f"{where}: {PLACEMENT}: expected a whole number below {MOST_PLACES}, got {raw!r:.40}"
        )
    return int(number)


def _refuse_other_joints(log: Log, head: HeadModel) -> None:
    if log.head.joints != head.joints:
        own, theirs = (
            ", ".join(dict.fromkeys(name for name in each.joints if name)) or "none"
            for each in (head, log.head)
        )
        raise ConfigurationError(
            f"{log.path}: expected a log of the head {head.name} with the joints {own}, got one of "
            f"{log.head.name} with {theirs}"
        )


def _board_views(log: Log, head: HeadModel, target: PlanarTarget) -> tuple[list[BoardView], int]:
    """Read a log's board views in the order of time, and count the images taken in motion."""
    count = len(target.corners_m)
    # by eye and time; a detection may have been logged twice
    eyes: dict[str, dict[float, LoggedDetection]] = {name: {} for name in EYE_NAMES}
    moving = 0
    at_rest = _rest_test(log, head)
    for one in log.detections:
        if not len(one.corners_px):
            continue
        if not len(one.corners_px) == len(one.corners_sigma_px) == count:
            raise ConfigurationError(
                f"{log.path}: /detection: expected the {count} corners of {target}, got "
                f"{len(one.corners_px)}"
            )
        if not (np.isfinite(one.exposed_s) and np.isfinite(one.positions).all()):
            continue
        if not at_rest(one.exposed_s, one.positions):
            moving += 1
            continue
        other = eyes[one.eye].setdefault(one.exposed_s, one)
        if not np.array_equal(one.corners_px, other.corners_px, equal_nan=True):
            raise ConfigurationError(
                f"expected times that tell images apart, got two of the {one.eye} eye at "
                f"{one.exposed_s:g} s"
            )
    left, right = (list(each.values()) for each in eyes.values())
    gaps = np.abs(np.subtract.outer(*([one.exposed_s for one in each] for each in (left, right))))
    # mutually nearest in time
    pairs = {
        i: j
        for i, j in enumerate(gaps.argmin(axis=1).tolist() if gaps.size else ())
        if gaps[:, j].argmin() == i and gaps[i, j] <= 0.5 * head.timing.frame_s
    }
    found = [_view(one, right[pairs[i]] if i in pairs else None) for i, one in enumerate(left)]
    taken = set(pairs.values())
    found += [_view(None, one) for j, one in enumerate(right) if j not in taken]
    return sorted(found, key=lambda one: one.time_s), moving


def _rest_test(log: Log, head: HeadModel) -> Callable[[float, FloatArray], bool]:
    """Test by a log's angles if joints rest around a time; a quantisation step is no motion."""
    if log.facts.get(AT_REST) == str(True):
        return lambda time_s, positions: True
    own = head.actuation
    when = [one.exposed_s for one in log.detections] + [one.clock_s for one in log.joints]
    seen = [one.positions for one in log.detections] + [one.positions for one in log.joints]
    rows = np.column_stack([when, np.array(seen).reshape(-1, 7)])
    rows = rows[np.isfinite(rows).all(axis=-1)]
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    times, angles = rows[:, 0], own.actuators_of(rows[:, 1:])

    def at_rest(time_s: float, positions: FloatArray) -> bool:
        near = slice(*np.searchsorted(times, (time_s - _REST_WINDOW_S, time_s + _REST_WINDOW_S)))
        away = np.abs(angles[near] - own.actuators_of(positions))
        after_s = np.abs(times[near] - time_s)[:, None]
        return bool((away - own.angle_step <= _STILL_RAD_S * after_s + 1e-9).all())

    return at_rest


def _view(left: LoggedDetection | None, right: LoggedDetection | None) -> BoardView:
    there = [one for one in (left, right) if one is not None]
    return BoardView(
        float(np.mean([one.exposed_s for one in there])),
        np.mean([one.positions for one in there], axis=0),
        (left and left.corners_px, right and right.corners_px),
        (left and left.corners_sigma_px, right and right.corners_sigma_px),
    )


def _read_photographs(
    path: Path,
    head: HeadModel,
    target: PlanarTarget | None,
    progress: Callable[[float], None] | None = None,
) -> HeadRecording:
    """Read frames of a folder with `left` and `right`, images named alike, and one of `TABLES`."""
    if target is None:
        raise ConfigurationError(
            f"{path}: expected the board of these photographs as --target, got none"
        )
    tables = [path / name for name in TABLES if (path / name).exists()]
    if len(tables) != 1:
        raise ConfigurationError(
            f"{path}: expected one of {', '.join(TABLES)} with the angles of each pair of images, "
            f"got {join_first_names(table.name for table in tables) or 'none'}"
        )
    found = pair_up(*(path / eye for eye in EYE_NAMES))
    names = [pair.name for pair in found.pairs]
    rows = read_pair_rows(tables[0], names)
    taken = [_read_row(head, rows[name], f"{tables[0]}: {name}") for name in names]
    untimed = [name for name in names if _TIME_COLUMN not in rows[name]]
    if 0 < len(untimed) < len(names):
        raise ConfigurationError(
            f"{tables[0]}: expected {_TIME_COLUMN} of all pairs or of none, got none of "
            f"{join_first_names(untimed)}"
        )
    images = [list(each) for each in zip(*found.pairs, strict=True)]
    seen, failures = detect_board_corners(target, images, progress, head.cameras.response)
    for eye, size, own in zip(EYE_NAMES, seen.image_sizes, head.cameras.size.tolist(), strict=True):
        if tuple(own) != size:
            raise ConfigurationError(
                f"{path / eye}: expected images of {own[0]} x {own[1]} px, as the head "
                f"{head.name} has, got {size[0]} x {size[1]}"
            )
    views = [
        BoardView(
            view if untimed else time_s, positions,
            (seen.pixels[0, view], seen.pixels[1, view]),
            (seen.sigma[0, view], seen.sigma[1, view]),
        )
        for view, (positions, _, time_s) in enumerate(taken)
    ]  # fmt: skip
    alone = [one.name for one in found.unpaired]
    remark = f"{len(alone)} images without a partner left out: {join_first_names(alone)}"
    files = [str(one.relative_to(path)) for pair in found.pairs for one in pair]
    return HeadRecording(
        frames=HeadFrames.of_views(target, views, [place for _, place, _ in taken]),
        files=(*files, tables[0].name), remarks=(remark,) if alone else (),
        read_errors=tuple(failures),
    )  # fmt: skip


def _read_row(head: HeadModel, row: Row, where: str) -> tuple[FloatArray, int, float]:
    """Read joint angles, rad, placement and time, by default 0, of a pair of photographs."""
    time_s, place = (
        parse_finite_number(row.get(name, 0), f"{where}: {name}")
        for name in (_TIME_COLUMN, PLACEMENT)
    )
    angles = {name: value for name, value in row.items() if name not in (_TIME_COLUMN, PLACEMENT)}
    placement = _placement(row.get(PLACEMENT, 0), place, where)
    return parse_joint_angles(head, angles, where), placement, time_s
