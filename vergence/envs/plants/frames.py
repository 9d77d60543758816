r"""The cameras' clock: when frames are exposed, which of them come, and when.

Frame f of a trial is exposed about the time `(phase + f) (1 + drift) / rate`, by the cameras' own
clock, which knows nothing of the control period. It becomes readable after the latency and a
jitter of its own, but never before one that was exposed earlier; a dropped frame never does. What
a frame has, its faults, is a function of the trial and of f.

Where the right eye is exposed after the left, by the trial's skew, a frame has two exposures: those
of frame f are numbers 2 f and 2 f + 1. Elsewhere both eyes share number f.
"""

from math import ceil, cos, pi, sin
from typing import Final, NamedTuple

import numpy as np

from vergence._jit import device, subroutine
from vergence.envs.plants.conditions import Loop
from vergence.envs.reading import BoolArray
from vergence.envs.streams import (
    IntArray,
    Key,
    Purpose,
    Words,
    random_words,
    to_normals,
    to_uniform,
)
from vergence.models.parts import FloatArray

SAME_S: Final = 1e-9
"""Times that differ by less are one: what rounding leaves of sums of periods."""
_SENSOR: Final = int(Purpose.SENSOR)
_BEFORE: Final = int(Purpose.BEFORE)


def ring_size(least: int) -> int:
    """The length of a ring for at least so many: a power of two, so that a mask finds a place."""
    return 1 << (least - 1).bit_length()


class Frames(NamedTuple):
    """The frames that have been exposed and may not have come yet: frame f lies at f modulo F.

    F is a power of two, as the length of every ring here.
    """

    pixels: FloatArray
    """(n, F, 2, 2) what the detector made of both eyes' frames, px."""
    visible: BoolArray
    """(n, F, 2) whether it saw the target."""
    dropped: BoolArray
    """(n, F) whether the frame never comes."""
    exposed_s: FloatArray
    """(n, F) the middle of the exposure, since the trial's start."""
    comes_s: FloatArray
    """(n, F) when it becomes readable."""
    next: IntArray
    """(n,) the exposure that comes next, see `frame_of`."""
    pending: IntArray
    """(n,) the first one that has not come."""
    latest_s: FloatArray
    """(n,) when the last one of those exposed becomes readable."""

    @classmethod
    def empty(cls, num: int, longest_s: float, most_hz: float) -> "Frames":
        """Rings without frames.

        Args:
            num: how many heads.
            longest_s: the longest time from an exposure to the end of the period in which it is
                read, s.
            most_hz: the greatest frame rate.
        """
        size = ring_size(ceil(longest_s * most_hz) + 2)
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
    """The exposures that fall into the present period, and how the heads stand then."""

    taken: IntArray
    """(n,) how many."""
    time_s: FloatArray
    """(n, E) the middle of each exposure, since the trial's start."""
    positions: FloatArray
    """(n, E, 7) joint angles, rad."""
    velocities: FloatArray
    """(n, E, 7) joint velocities, rad/s."""

    @classmethod
    def empty(cls, num: int, period_s: float, most_hz: float, each: int = 1) -> "Exposures":
        """Room for those of a period at the greatest frame rate, so many a frame."""
        size = each * (ceil(period_s * most_hz) + 1)
        return cls(
            taken=np.zeros(num, dtype=np.int64),
            time_s=np.zeros((num, size)),
            positions=np.zeros((num, size, 7)),
            velocities=np.zeros((num, size, 7)),
        )


class Faults(NamedTuple):
    """What chance does to one pair of frames; numbers from 0 to below 1 decide."""

    dropped: bool
    late_s: float
    """By how much it comes later than the latency."""
    missed_left: bool
    missed_right: bool


@device
def frame_time(loop: Loop, frame: int) -> float:
    """When a frame is exposed, since the trial's start, s."""
    return (loop.frame_phase + frame) * loop.frame_s


class FrameOf(NamedTuple):
    """What an exposure belongs to."""

    frame: int
    first_eye: int
    """The first of the eyes that are exposed."""
    end_eye: int
    """The eye after the last one."""


@device
def frame_of(loop: Loop, exposure: int) -> FrameOf:
    """The frame of an exposure, and which eyes are exposed."""
    if loop.skew_s == 0.0:
        return FrameOf(exposure, 0, 2)
    eye = exposure & 1
    return FrameOf(exposure >> 1, eye, eye + 1)


@device
def first_exposure(loop: Loop, frame: int) -> int:
    """The first exposure of a frame."""
    return frame if loop.skew_s == 0.0 else 2 * frame


@device
def skew_of(loop: Loop) -> float:
    """How long the right eye is exposed after the left, s."""
    return min(loop.skew_s, loop.frame_s)


@device
def exposure_time(loop: Loop, exposure: int) -> float:
    """When an exposure is, since the trial's start, s."""
    if loop.skew_s == 0.0:
        return frame_time(loop, exposure)
    return frame_time(loop, exposure >> 1) + (exposure & 1) * skew_of(loop)


@device
def _words(key: Key, frame: int, lane: int) -> Words:
    """The lane-th four random words of a frame; lane 1 is that of the detection noise."""
    if frame >= 0:
        return random_words(key.seed, key.trial, _SENSOR, frame, lane)
    return random_words(key.seed, key.trial, _BEFORE, -frame, lane)


@device
def faults_of(loop: Loop, key: Key, frame: int) -> Faults:
    """The faults of a frame."""
    drop, jitter = loop.dropped_frame_probability, loop.jitter_s
    miss = loop.missed_detection_probability
    if drop + jitter + miss == 0.0:
        return Faults(False, 0.0, False, False)
    words = _words(key, frame, 2)
    return Faults(
        to_uniform(words[0]) < drop,
        jitter * to_uniform(words[1]),
        to_uniform(words[2]) < miss,
        to_uniform(words[3]) < miss,
    )


@device
def pixel_noise(loop: Loop, key: Key, frame: int) -> tuple[float, float, float, float]:
    """The detections' errors in one pair of frames: u and v left, u and v right."""
    sigma = loop.detection_noise_px
    if sigma == 0.0:
        return 0.0, 0.0, 0.0, 0.0
    words = _words(key, frame, 1)
    a, b = to_normals(words[0], words[1])
    c, d = to_normals(words[2], words[3])
    return sigma * a, sigma * b, sigma * c, sigma * d


@device
def _beside(most_px: float, size: np.uint64, direction: np.uint64) -> tuple[float, float]:
    """An offset that is uniform in size and direction, px."""
    length, around = most_px * to_uniform(size), 2.0 * pi * to_uniform(direction)
    return length * cos(around), length * sin(around)


@device
def outlier(loop: Loop, key: Key, frame: int, eye: int) -> tuple[float, float]:
    """How far an eye's detection is beside the target by a fault, px; nothing for most."""
    probability = loop.outlier_probability
    if probability == 0.0 or not to_uniform(_words(key, frame, 3)[eye]) < probability:
        return 0.0, 0.0
    words = _words(key, frame, 4 + eye)
    return _beside(loop.outlier_px, words[0], words[1])


@subroutine
def false_detection(loop: Loop, key: Key, frame: int, eye: int) -> tuple[float, float]:
    """How far what an eye takes for the target is beside it, px; nothing for most.

    What began last replaces what is taken for the target already.
    """
    probability = loop.false_detection_probability
    frames = loop.false_detection_s / loop.frame_s
    for age in range(max(int(np.rint(frames)), 1)):
        words = _words(key, frame - age, 6)
        if not to_uniform(words[0]) < probability:
            continue
        if age >= max(int(np.rint(frames * to_uniform(words[1]))), 1):
            continue
        # the left eye, the right, both, both by the same
        kind = int(6.0 * to_uniform(words[2]))
        if (kind < 2 and eye == 1) or (2 <= kind < 4 and eye == 0):
            continue
        words = _words(key, frame - age, 7)
        if eye == 0 or kind == 5:
            return _beside(loop.false_detection_px, words[0], words[1])
        return _beside(loop.false_detection_px, words[2], words[3])
    return 0.0, 0.0


@device
def comes_at(loop: Loop, exposed_s: float, late_s: float, latest_s: float) -> float:
    """When a frame becomes readable: never before one that was exposed earlier, s.

    Args:
        loop: the trial's conditions.
        exposed_s: when its first eye was exposed, s.
        late_s: by how much it is later than the latency, s.
        latest_s: when the frame before becomes readable, s.
    """
    return max(exposed_s + skew_of(loop) + loop.latency_s + late_s, latest_s)
