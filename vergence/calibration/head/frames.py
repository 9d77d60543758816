"""Frames of a board by both eyes of a moving head, with the joint angles read for each."""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vergence.models.head import HeadModel
from vergence.models.parts import NECK, FloatArray
from vergence.triangulation import Noise
from vergence.vision.targets import PlanarTarget

IntArray = NDArray[np.intp]
SAME_POSE_RAD: Final = 0.026
"""Bound on the difference of frames of one pose in every joint, rad (chosen: 1.5 degrees, between
the dither of some tenths of a degree and the distance of poses of some degrees)."""
_STILL_POSE_FRACTION: Final = 0.8
"""Fraction of the poses in which a joint's reading must not change for the joint to count as one
without dither (chosen)."""


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

    def select(self, frames: NDArray[np.bool_] | IntArray) -> "HeadFrames":
        """Select some of the frames."""
        return HeadFrames(
            target=self.target, time_s=self.time_s[frames],
            joint_positions=self.joint_positions[frames],
            pixels=self.pixels[:, frames], sigma=self.sigma[:, frames],
            placement=self.placement[frames],
        )  # fmt: skip

    @cached_property
    def corners(self) -> FloatArray:
        """(n, 3) the board's corners relative to their middle, metres."""
        flat = np.column_stack([self.target.corners_m, np.zeros(len(self.target.corners_m))])
        return np.asarray(flat - flat.mean(axis=0))

    @cached_property
    def seen(self) -> NDArray[np.bool_]:
        """(2, f, n) True for corners that were found."""
        return np.asarray(np.isfinite(self.pixels).all(axis=-1))

    @cached_property
    def pose(self) -> IntArray:
        """(f,) number of the pose that each frame belongs to, see `SAME_POSE_RAD`."""
        numbers = np.zeros(len(self.time_s), dtype=np.intp)
        first = 0
        for frame in range(1, len(numbers)):
            near = (
                np.abs(self.joint_positions[frame] - self.joint_positions[first]).max()
                < SAME_POSE_RAD
            )
            same = near and self.placement[frame] == self.placement[first]
            numbers[frame] = numbers[frame - 1] + (not same)
            if not same:
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
            places = [frames.placement == place for place in np.unique(frames.placement)]
            if joint < NECK.stop and all(
                np.ptp(angles[place, joint]) <= step[joint] for place in places
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
    """Return True if a joint's reading stays within a step in most poses."""
    spans = [
        np.ptp(angles[pose == each])
        for each, count in zip(*np.unique(pose, return_counts=True), strict=True)
        if count > 1
    ]
    return (
        bool(len(spans))
        and float(np.mean(np.array(spans) <= _SAME_READING_STEPS * step)) >= _STILL_POSE_FRACTION
    )


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
