"""What a moving head saw of a board: frames of both eyes, with the joint angles read for each."""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vergence.models.boards import PlanarTarget
from vergence.models.head import HeadModel
from vergence.models.joints import NECK
from vergence.models.parts import FloatArray
from vergence.triangulation import Noise

IntArray = NDArray[np.intp]
POSE_RAD: Final = 0.026
"""Frames of one pose differ by less than this in every joint, rad: 1.5 degrees. Dither is some
tenths of a degree, poses lie degrees apart."""
_STILL_SHARE: Final = 0.8
"""Share of the poses in which a joint's reading must not change for it to count as one that does
not dither."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HeadFrames:
    """Frames of a head before a board, in the order of time."""

    target: PlanarTarget
    time_s: FloatArray
    """(f,) of the exposures, s."""
    positions: FloatArray
    """(f, 7) joint angles that were read, rad."""
    pixels: FloatArray
    """(2, f, n, 2) raw pixels of the board's corners by eye; nan for those that were not found."""
    sigma: FloatArray
    """(2, f, n, 2) their standard deviations, px."""
    placement: IntArray
    """(f,) number of the board's place in frame 0, from 0 on: it moved where this changes."""

    def of(self, frames: NDArray[np.bool_] | IntArray) -> "HeadFrames":
        """Some of the frames."""
        return HeadFrames(
            target=self.target, time_s=self.time_s[frames], positions=self.positions[frames],
            pixels=self.pixels[:, frames], sigma=self.sigma[:, frames],
            placement=self.placement[frames],
        )  # fmt: skip

    @cached_property
    def corners(self) -> FloatArray:
        """(n, 3) the board's corners in its frame, metres, from their middle."""
        flat = np.column_stack([self.target.corners_m, np.zeros(len(self.target.corners_m))])
        return np.asarray(flat - flat.mean(axis=0))

    @cached_property
    def seen(self) -> NDArray[np.bool_]:
        """(2, f, n) which corners were found."""
        return np.asarray(np.isfinite(self.pixels).all(axis=-1))

    @cached_property
    def pose(self) -> IntArray:
        """(f,) number of the pose that each frame belongs to, see `POSE_RAD`."""
        numbers = np.zeros(len(self.time_s), dtype=np.intp)
        first = 0
        for frame in range(1, len(numbers)):
            near = np.abs(self.positions[frame] - self.positions[first]).max() < POSE_RAD
            same = near and self.placement[frame] == self.placement[first]
            numbers[frame] = numbers[frame - 1] + (not same)
            if not same:
                first = frame
        return numbers


@dataclass(frozen=True, eq=False)
class JointErrors:
    """Which true angles are unknown, and which frames share one.

    An encoder's reading is off by up to half a step. A joint that moves between frames is off
    by another amount in each. One that rests is off by the same amount as long as it rests, and a
    neck that rests before one place of the board moves the board's unknown pose only.
    """

    angles: FloatArray
    """(f, 7) the actuators' angles that were read, rad; of resting joints the mean reading."""
    sigma: FloatArray
    """(7,) deviation of a reading, rad."""
    own: NDArray[np.bool_]
    """(f, 7) which angles have an error of their own frame."""
    run: IntArray
    """(f, 7) the number of the error that frames share; -1 for none."""
    runs: IntArray
    """(r,) the actuator of each shared error."""

    @classmethod
    def of(cls, head: HeadModel, frames: HeadFrames) -> "JointErrors":
        """The unknown angles of frames.

        Args:
            head: whose steps and play count.
            frames: in the order of time.
        """
        own = head.actuation
        angles = own.actuators_of(frames.positions)
        sigma = np.asarray(Noise.of(head).joint_rad)
        step = np.maximum(own.angle_step, own.backlash)
        moves = np.asarray(own.upper > own.lower) & (sigma > 0.0)
        free = np.broadcast_to(moves, angles.shape).copy()
        run = np.full(angles.shape, -1, dtype=np.intp)
        runs: list[int] = []
        resting: list[int] = []
        for joint in np.flatnonzero(moves).tolist():
            places = [frames.placement == place for place in np.unique(frames.placement)]
            if joint < NECK.stop and all(
                np.ptp(angles[place, joint]) <= step[joint] for place in places
            ):
                free[:, joint] = False  # what it is off by moves the board's unknown pose alone
            elif _rests(angles[:, joint], frames.pose, step[joint]):
                resting.append(joint)
        # a joint whose reading happens to stay when others move has moved within a step
        stretches = _stretches(angles[:, resting], step[resting], frames.placement)
        for joint in resting:
            free[:, joint] = False
            for begin, end in stretches:
                run[begin:end, joint] = len(runs)
                runs.append(joint)
                angles[begin:end, joint] = angles[begin:end, joint].mean()
        return cls(angles, sigma, free, run, np.array(runs, dtype=np.intp))


def _rests(angles: FloatArray, pose: IntArray, step: float) -> bool:
    """Whether a joint's reading stays within a step in most of the poses."""
    spans = [
        np.ptp(angles[pose == each])
        for each, count in zip(*np.unique(pose, return_counts=True), strict=True)
        if count > 1
    ]
    return bool(len(spans)) and float(np.mean(np.array(spans) <= _SAME * step)) >= _STILL_SHARE


def _stretches(angles: FloatArray, step: FloatArray, placement: IntArray) -> list[tuple[int, int]]:
    """Frames one after the other in which all readings stay within a step."""
    found, begin = [], 0
    for frame in range(1, len(angles) + 1):
        if frame < len(angles) and placement[frame] == placement[begin]:
            stretch = angles[begin : frame + 1]
            if (np.ptp(stretch, axis=0) <= _SAME * step).all():
                continue
        found.append((begin, frame))
        begin = frame
    return found


_SAME: Final = 1.01
"""Steps within which a reading is the same: rounding, and an angle on the edge of a step."""
