"""Sights from robots' logs: simultaneous detections of both eyes while the head is at rest."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from vergence.calibration.head.gathered import MOST_PLACES, RawRecording
from vergence.calibration.observations import parse_board
from vergence.errors import ConfigurationError, UnreadableFileError
from vergence.models.head import HeadModel
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.perception.photographs import natural_sort_key
from vergence.recording.log import Log, read_log
from vergence.recording.looking import BoardView
from vergence.recording.schema import LoggedDetection
from vergence.vision.targets import PlanarTarget

AT_REST: Final = "at_rest"
"""Name of a log's fact that is `True` if every image was taken at rest."""
HEAD_IDENTITY: Final = "looks"
"""Name of a log's fact that distinguishes heads with the same file."""
PLACEMENT: Final = "placement"
"""Name of a log's fact with the number of the board's placement."""
TARGET: Final = "target"
"""Name of a log's fact with the board, in the form of `parse_target`."""
SUFFIX: Final = ".mcap"
"""File suffix of a log."""
_LOG_GAP_S: Final = 1.0
"""Time from the last frame of a log to the first of the next one, s (chosen: clocks may have been
set between them, so that their own times cannot be used)."""
_REST_WINDOW_S: Final = 0.15
"""Time before and after an exposure in which a joint at rest must not move, s (chosen: backlash and
brackets have settled then)."""
_STILL_RAD_S: Final = 0.02
"""Speed of a joint up to which it counts as at rest, rad/s (chosen: with 5 ms between an image and
its angles it causes 0.1 mrad, a fifteenth of a 12-bit encoder's step)."""


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
) -> RawRecording:
    """Read the board views of logs, one after the other; by default of the board they name."""
    board_views: list[BoardView] = []
    placement: list[int] = []
    files, remarks, failures = [], [], []
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
        board_views += [one._replace(time_s=one.time_s + begins_s) for one in found]
        placement += [_placement_of(log)] * len(found)
        if found:
            begins_s = board_views[-1].time_s + _LOG_GAP_S
        moving += moved
        unlike += log.head.digest != head.digest
        cut += bool(log.truncation_reason)
        if progress is not None:
            progress(number / len(paths))
    if target is None or not files:
        raise ConfigurationError(f"expected logs that can be read, got none; {failures[0]}")
    if moving:
        remarks.append(f"{moving} images left out, as joints were moving")
    if unlike:
        remarks.append(
            f"{unlike} of {len(files)} logs: the head had other numbers than {head.name}"
        )
    if cut:
        remarks.append(f"{cut} of {len(files)} logs are cut off: read up to there")
    return RawRecording(
        target, board_views, placement, tuple(files), tuple(remarks), tuple(failures), *looked
    )


def _target_of(log: Log, target: PlanarTarget | None) -> PlanarTarget:
    """Get the board of a log; refuse one that differs from the expected board."""
    text = log.facts.get(TARGET, "")
    if not text and target is None:
        raise ConfigurationError(
            f"{log.path}: expected the board among the log's facts, or as --target, got neither"
        )
    if not text:
        assert target is not None
        return target
    try:
        own = parse_board(text, accept_single_tag=True)
    except ConfigurationError as error:
        raise ConfigurationError(f"{log.path}: {error}") from error
    if target is not None and str(own) != str(target):
        raise ConfigurationError(f"{log.path}: target: expected {target}, got a log of {own}")
    return own


def _placement_of(log: Log) -> int:
    text = log.facts.get(PLACEMENT, "0")
    if not (text.isdecimal() and int(text) < MOST_PLACES):
        raise ConfigurationError(
            f"{log.path}: {PLACEMENT}: expected a whole number below {MOST_PLACES}, got "
            f"{text!r:.40}"
        )
    return int(text)


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
    """Read a log's board views in the order of time, from zero on, and count images in motion."""
    count = len(target.corners_m)
    eyes: list[list[LoggedDetection]] = [[], []]
    moving = 0
    still = _Still(log, head)
    for one in log.detections:
        if not len(one.corners_px):
            continue
        if len(one.corners_px) != count or len(one.corners_sigma_px) != count:
            raise ConfigurationError(
                f"{log.path}: /detection: expected the {count} corners of {target}, got "
                f"{len(one.corners_px)}"
            )
        if not (np.isfinite(one.exposed_s) and np.isfinite(one.positions).all()):
            continue
        if still.at(one.exposed_s, one.positions):
            eyes[EYE_NAMES.index(one.eye)].append(one)
        else:
            moving += 1
    found = [_board_view(pair) for pair in _paired(eyes, 0.5 * head.timing.frame_s)]
    found.sort(key=lambda one: one.time_s)
    zero_s = found[0].time_s if found else 0.0
    return [one._replace(time_s=one.time_s - zero_s) for one in found], moving


class _Still:
    """Test for rest by the measured joint angles of a log."""

    def __init__(self, log: Log, head: HeadModel) -> None:
        self._trusted = log.facts.get(AT_REST) == str(True)
        self._own = head.actuation
        seen = [(one.exposed_s, one.positions) for one in log.detections]
        seen += [(one.clock_s, one.positions) for one in log.joints]
        times = np.array([time_s for time_s, _ in seen])
        angles = np.array([positions for _, positions in seen]).reshape(-1, 7)
        known = np.isfinite(times) & np.isfinite(angles).all(axis=-1)
        order = np.argsort(times[known], kind="stable")
        self._times = times[known][order]
        self._angles = self._own.actuators_of(angles[known][order])

    def at(self, time_s: float, positions: FloatArray) -> bool:
        """True if joints rest around a time at positions; one quantisation step is no motion."""
        if self._trusted:
            return True
        first, last = np.searchsorted(
            self._times, (time_s - _REST_WINDOW_S, time_s + _REST_WINDOW_S)
        )
        away = np.abs(self._angles[first:last] - self._own.actuators_of(positions))
        after_s = np.abs(self._times[first:last] - time_s)[:, None]
        return bool((away - self._own.angle_step <= _STILL_RAD_S * after_s + 1e-9).all())


def _paired(
    eyes: Sequence[Sequence[LoggedDetection]], tolerance_s: float
) -> list[tuple[LoggedDetection | None, LoggedDetection | None]]:
    """Pair detections of both eyes that are mutually nearest in time; keep unpaired ones too."""
    left, right = (_once(each) for each in eyes)
    partner: dict[int, int] = {}
    if left and right:
        gaps = np.abs(np.subtract.outer(_times(left), _times(right)))
        nearest, theirs = gaps.argmin(axis=1).tolist(), gaps.argmin(axis=0).tolist()
        partner = {
            i: j for i, j in enumerate(nearest) if theirs[j] == i and gaps[i, j] <= tolerance_s
        }
    pairs: list[tuple[LoggedDetection | None, LoggedDetection | None]] = []
    pairs += [(one, right[partner[i]] if i in partner else None) for i, one in enumerate(left)]
    taken = set(partner.values())
    pairs += [(None, one) for j, one in enumerate(right) if j not in taken]
    return pairs


def _once(detections: Sequence[LoggedDetection]) -> list[LoggedDetection]:
    """Remove detections logged twice, which are equal to the last bit; refuse unequal ones."""
    by_time: dict[float, LoggedDetection] = {}
    for one in detections:
        other = by_time.setdefault(one.exposed_s, one)
        if not np.array_equal(one.corners_px, other.corners_px, equal_nan=True):
            raise ConfigurationError(
                f"expected times that tell images apart, got two of the {one.eye} eye at "
                f"{one.exposed_s:g} s"
            )
    return list(by_time.values())


def _times(detections: Sequence[LoggedDetection]) -> FloatArray:
    return np.array([one.exposed_s for one in detections])


def _board_view(pair: tuple[LoggedDetection | None, LoggedDetection | None]) -> BoardView:
    there = [one for one in pair if one is not None]
    left, right = pair
    return BoardView(
        float(np.mean([one.exposed_s for one in there])),
        np.mean([one.positions for one in there], axis=0),
        (None if left is None else left.corners_px, None if right is None else right.corners_px),
        (
            None if left is None else left.corners_sigma_px,
            None if right is None else right.corners_sigma_px,
        ),
    )
