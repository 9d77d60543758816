r"""The cameras' clock: times of exposure and arrival of frames, and their faults.

The middle of the exposure of frame f of a trial is at `(phase + f) (1 + drift) / rate`, on the
cameras' own clock, which is independent of the control period. The frame becomes readable after the
latency and a jitter of its own, but never before an earlier frame; a dropped frame never does. The
faults of a frame depend only on the trial and on f.

If the right eye is exposed after the left, by the trial's skew, frame f has two exposures, numbers
2 f and 2 f + 1. Otherwise both eyes share exposure number f.
"""

from math import ceil, cos, pi, sin
from typing import Final, NamedTuple

import numpy as np

from vergence.envs.plants.conditions import TrialConditions
from vergence.envs.reading import BoolArray
from vergence.envs.streams import (
    IntArray,
    StreamKey,
    StreamPurpose,
    Words,
    random_words,
    to_normals,
    to_uniform,
)
from vergence.kernels import inlined, subroutine
from vergence.models.parts import FloatArray

TIME_TOLERANCE_S: Final = 1e-9
"""Difference below which two times are equal: rounding of sums of periods, s (numerical)."""
_SENSOR: Final = int(StreamPurpose.SENSOR)
_SENSOR_BEFORE_START: Final = int(StreamPurpose.SENSOR_BEFORE_START)


def ring_size(min_length: int) -> int:
    """Length of a ring buffer of at least `min_length`: a power of two, so a mask is modulo."""
    return 1 << (min_length - 1).bit_length()


class Frames(NamedTuple):
    """Ring buffers of exposed frames that may not have arrived yet: frame f lies at f modulo F.

    F is a power of two, as is the length of every ring buffer here.
    """

    pixels: FloatArray
    """(n, F, 2, 2) detections in both eyes' frames, px."""
    visible: BoolArray
    """(n, F, 2) True if the target was detected."""
    dropped: BoolArray
    """(n, F) True if the frame never arrives."""
    exposed_s: FloatArray
    """(n, F) middle of the exposure since the trial's start, s."""
    comes_s: FloatArray
    """(n, F) time at which the frame becomes readable, s."""
    next: IntArray
    """(n,) number of the next exposure, see `exposed_eyes`."""
    pending: IntArray
    """(n,) number of the first frame that has not arrived."""
    latest_s: FloatArray
    """(n,) time at which the last exposed frame becomes readable, s."""

    @classmethod
    def empty(cls, num: int, max_latency_s: float, max_hz: float) -> "Frames":
        """Ring buffers without frames.

        Args:
            num: number of heads.
            max_latency_s: the longest time from an exposure to the end of the period in which it is
                read, s.
            max_hz: the highest frame rate, Hz.
        """
        size = ring_size(ceil(max_latency_s * max_hz) + 2)
        return cls(
            pixels=np.zeros((num, size, 2, 2)),
            visible=np.zeros((num, size, 2), dtype=np.bool_),
            dropped=np.zeros((num, size), dtype=np.bool_),
            exposed_s=np.zeros((num, size)),
            comes_s=np.zeros((num, size)),
            next=np.zeros(num, dtype=np.int64),
            pending=np.zeros(num, dtype=np.int64),
            latest_s=np.zeros(num),
        )


class Exposures(NamedTuple):
    """The exposures within the present period, and the joints at their times."""

    counts: IntArray
    """(n,) number of exposures."""
    time_s: FloatArray
    """(n, E) middle of each exposure since the trial's start, s."""
    positions: FloatArray
    """(n, E, 7) joint angles, rad."""
    velocities: FloatArray
    """(n, E, 7) joint velocities, rad/s."""

    @classmethod
    def empty(
        cls, num: int, period_s: float, max_hz: float, exposures_per_frame: int = 1
    ) -> "Exposures":
        """Arrays for a period at the highest frame rate."""
        size = exposures_per_frame * (ceil(period_s * max_hz) + 1)
        return cls(
            counts=np.zeros(num, dtype=np.int64),
            time_s=np.zeros((num, size)),
            positions=np.zeros((num, size, 7)),
            velocities=np.zeros((num, size, 7)),
        )


class FrameFaults(NamedTuple):
    """Random faults of one pair of frames."""

    dropped: bool
    extra_latency_s: float
    """Delay beyond the latency, s."""
    missed_left: bool
    missed_right: bool


@inlined
def frame_exposure_time(conditions: TrialConditions, frame: int) -> float:
    """Time of a frame's (first) exposure since the trial's start, s."""
    return (conditions.frame_phase + frame) * conditions.frame_s


class ExposedEyes(NamedTuple):
    """Frame and eyes of an exposure."""

    frame: int
    first_eye: int
    """Index of the first exposed eye."""
    end_eye: int
    """One past the index of the last exposed eye."""


@inlined
def exposed_eyes(conditions: TrialConditions, exposure: int) -> ExposedEyes:
    """Find the frame of an exposure, and the eyes that it exposes."""
    if conditions.skew_s == 0.0:
        return ExposedEyes(exposure, 0, 2)
    eye = exposure & 1
    return ExposedEyes(exposure >> 1, eye, eye + 1)


@inlined
def first_exposure_of_frame(conditions: TrialConditions, frame: int) -> int:
    """The first exposure of a frame."""
    return frame if conditions.skew_s == 0.0 else 2 * frame


@inlined
def eye_skew_s(conditions: TrialConditions) -> float:
    """Delay of the right eye's exposure after the left's, at most one frame time, s."""
    return min(conditions.skew_s, conditions.frame_s)


@inlined
def exposure_time(conditions: TrialConditions, exposure: int) -> float:
    """Time of an exposure since the trial's start, s."""
    if conditions.skew_s == 0.0:
        return frame_exposure_time(conditions, exposure)
    return frame_exposure_time(conditions, exposure >> 1) + (exposure & 1) * eye_skew_s(conditions)


@inlined
def _words(key: StreamKey, frame: int, lane: int) -> Words:
    """Four random words of a frame; lane 1 is used for the detection noise."""
    if frame >= 0:
        return random_words(key.seed, key.trial, _SENSOR, frame, lane)
    return random_words(key.seed, key.trial, _SENSOR_BEFORE_START, -frame, lane)


@inlined
def draw_frame_faults(conditions: TrialConditions, key: StreamKey, frame: int) -> FrameFaults:
    """Draw the faults of a frame."""
    drop, jitter = conditions.dropped_frame_probability, conditions.jitter_s
    miss = conditions.missed_detection_probability
    if drop + jitter + miss == 0.0:
        return FrameFaults(False, 0.0, False, False)
    words = _words(key, frame, 2)
    return FrameFaults(
        to_uniform(words[0]) < drop,
        jitter * to_uniform(words[1]),
        to_uniform(words[2]) < miss,
        to_uniform(words[3]) < miss,
    )


@inlined
def pixel_noise(
    conditions: TrialConditions, key: StreamKey, frame: int
) -> tuple[float, float, float, float]:
    """Detection noise in one pair of frames, px: u and v left, u and v right."""
    sigma = conditions.detection_noise_px
    if sigma == 0.0:
        return 0.0, 0.0, 0.0, 0.0
    words = _words(key, frame, 1)
    a, b = to_normals(words[0], words[1])
    c, d = to_normals(words[2], words[3])
    return sigma * a, sigma * b, sigma * c, sigma * d


@inlined
def _random_offset(most_px: float, size: np.uint64, direction: np.uint64) -> tuple[float, float]:
    """Random offset, uniform in length and direction, px."""
    length, around = most_px * to_uniform(size), 2.0 * pi * to_uniform(direction)
    return length * cos(around), length * sin(around)


@inlined
def outlier_offset(
    conditions: TrialConditions, key: StreamKey, frame: int, eye: int
) -> tuple[float, float]:
    """Offset of an eye's detection from the target if it is an outlier, px; mostly zero."""
    probability = conditions.outlier_probability
    if probability == 0.0 or not to_uniform(_words(key, frame, 3)[eye]) < probability:
        return 0.0, 0.0
    words = _words(key, frame, 4 + eye)
    return _random_offset(conditions.outlier_px, words[0], words[1])


@subroutine
def false_detection_offset(
    conditions: TrialConditions, key: StreamKey, frame: int, eye: int
) -> tuple[float, float]:
    """Offset of an eye's false detection from the target, px; mostly zero.

    A false detection that begins replaces one that is already under way.
    """
    probability = conditions.false_detection_probability
    frames = conditions.false_detection_s / conditions.frame_s
    for age in range(max(int(np.rint(frames)), 1)):
        words = _words(key, frame - age, 6)
        if not to_uniform(words[0]) < probability:
            continue
        if age >= max(int(np.rint(frames * to_uniform(words[1]))), 1):
            continue
        # 0, 1: left eye; 2, 3: right eye; 4: both; 5: both with the same offset
        kind = int(6.0 * to_uniform(words[2]))
        if (kind < 2 and eye == 1) or (2 <= kind < 4 and eye == 0):
            continue
        words = _words(key, frame - age, 7)
        if eye == 0 or kind == 5:
            return _random_offset(conditions.false_detection_px, words[0], words[1])
        return _random_offset(conditions.false_detection_px, words[2], words[3])
    return 0.0, 0.0


@inlined
def frame_arrival_time(
    conditions: TrialConditions, exposed_s: float, extra_latency_s: float, latest_s: float
) -> float:
    """Time at which a frame becomes readable, never before an earlier frame, s.

    Args:
        conditions: the trial's conditions.
        exposed_s: exposure time of its first eye, s.
        extra_latency_s: delay beyond the latency, s.
        latest_s: time at which the frame before becomes readable, s.
    """
    return max(
        exposed_s + eye_skew_s(conditions) + conditions.latency_s + extra_latency_s, latest_s
    )
