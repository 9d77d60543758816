"""Pairing of left and right images that were exposed at about the same time.

Two images are a pair if their exposures are at most a tolerance apart. Images arrive in the order
of their exposures, so an image is certainly alone once the other eye has a later one that is not
its partner either. Until then it waits, up to a time limit.

Conversion of two eyes' pixels, exposed at different times, to one common time.

Unsynchronised cameras expose up to half a frame period apart; in this time the image of a turning
eye moves by tens of pixels. The joint angles are known at both times. So each eye's line of sight
is computed in the fixed frame 0 from the joint angles at its own exposure. The target lies on it at
the depth of the closest approach of the two lines (Eqs. 18 to 23),

    [ d_l.d_l  -d_l.d_r ] [s]   [ -d_l.w ]
    [-d_l.d_r   d_r.d_r ] [t] = [  d_r.w ],   w = o_l - o_r,

and is projected into the cameras at the joint angles of the common time. This is exact for a target
at rest; a moving target is off by its own motion in half of the time between the exposures.
"""

from collections import deque
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from vergence.envs.reading import Image
from vergence.hardware.drive import JointHistory
from vergence.models.camera import Camera
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.triangulation.rays import DEPTH_RANGE_M
from vergence.vision.detection import BoardDetection, Detection

_PARALLEL_SINE_SQUARED: Final = 1e-8
"""Squared sine of the angle below which two lines count as parallel: 0.1 mrad (numerical)."""


class SearchedImage(NamedTuple):
    """One eye's image after the detection."""

    exposed_s: float
    """Time of exposure, s of a monotonic clock."""
    ready_s: float
    """Time at which the detection ended, s."""
    pixel: FloatArray
    """(2,) raw pixel of the target; nan if it was not found."""
    detection: BoardDetection | Detection | None = None
    """Detection of the target; None if it was not found."""
    image: Image | None = None
    """The image itself, grey levels."""


class SearchedPair(NamedTuple):
    """A pair of images, or one eye's image alone."""

    left: SearchedImage | None
    right: SearchedImage | None

    @property
    def exposed_s(self) -> float:
        """The mean time of their exposures, s."""
        times = [one.exposed_s for one in self if one is not None]
        return sum(times) / len(times)

    @property
    def ready_s(self) -> float:
        """Time at which the later one was ready, s."""
        return max(one.ready_s for one in self if one is not None)


@dataclass
class PairCounts:
    """Numbers of pairs and of images without a partner."""

    pairs: int = 0
    unpaired_left: int = 0
    unpaired_right: int = 0


class Pairing:
    """Pairs the images of two eyes, exposed at most `tolerance_s` apart, as they arrive.

    An image waits for its partner for `wait_s` after it is ready; `counts` has what came of them.
    """

    def __init__(self, tolerance_s: float, wait_s: float) -> None:
        self._tolerance_s, self._wait_s = tolerance_s, wait_s
        self._waiting: tuple[deque[SearchedImage], deque[SearchedImage]] = (deque(), deque())
        self.counts = PairCounts()

    def add(self, eye: int, image: SearchedImage) -> None:
        """Add an image of an eye, 0 for left; each eye's images come in order of exposure."""
        self._waiting[eye].append(image)

    def next(self, now_s: float) -> SearchedPair | None:
        """The next pair or lone image, in the order of exposure; None while all wait."""
        left, right = self._waiting
        if left and right:
            apart_s = left[0].exposed_s - right[0].exposed_s
            if abs(apart_s) <= self._tolerance_s:
                self.counts.pairs += 1
                return SearchedPair(left.popleft(), right.popleft())
            return self._pop_unpaired(0 if apart_s < 0.0 else 1)
        for eye, queue in enumerate(self._waiting):
            if queue and now_s - queue[0].ready_s > self._wait_s:
                return self._pop_unpaired(eye)
        return None

    def _pop_unpaired(self, eye: int) -> SearchedPair:
        image = self._waiting[eye].popleft()
        if eye == 0:
            self.counts.unpaired_left += 1
            return SearchedPair(image, None)
        self.counts.unpaired_right += 1
        return SearchedPair(None, image)


def pixels_at_common_time(
    head: HeadModel, pixels: FloatArray, exposure_joints: FloatArray, common_joints: FloatArray
) -> FloatArray:
    """Convert both eyes' pixels to a common time.

    Args:
        head: the model of the head.
        pixels: (2, 2) raw pixels of the target by eye, px.
        exposure_joints: (2, 7) joint angles at each eye's own exposure, rad.
        common_joints: (7,) joint angles at the common time, rad.

    Returns:
        (2, 2) raw pixels, px; nan if a pixel has no ray or the target is out of view at that time.
    """
    q = np.vstack([exposure_joints, common_joints])
    T_0_C = head.base_pose(q)[:, np.newaxis] @ head.camera_poses(q)  # by time, by eye
    then = T_0_C[[0, 1], [0, 1]]
    cameras = _cameras(head)
    rays = [np.append(cameras[eye].rays(pixels[eye][None])[0], 1.0) for eye in range(2)]
    origins = then[:, :3, 3]
    directions = np.stack([then[eye, :3, :3] @ rays[eye] for eye in range(2)])
    points = origins + _depths(origins, directions)[:, None] * directions
    T_C_0 = np.linalg.inv(T_0_C[2])
    seen = np.einsum("eij,ej->ei", T_C_0[:, :3, :3], points) + T_C_0[:, :3, 3]
    return np.concatenate([cameras[eye].project(seen[eye][None]) for eye in range(2)])


@lru_cache(maxsize=8)
def _cameras(head: HeadModel) -> tuple[Camera, Camera]:
    """Both cameras, cached: preparing the lens models takes longer than the rest of a pair."""
    return Camera.of(head, 0), Camera.of(head, 1)


def _depths(origins: FloatArray, directions: FloatArray) -> FloatArray:
    """(2,) depths of the closest approach of two lines, in lengths of their directions.

    They are clipped to `DEPTH_RANGE_M`.
    """
    left, right = directions
    a, b, c = left @ left, left @ right, right @ right
    w = origins[0] - origins[1]
    determinant = a * c - b * b
    if not determinant > _PARALLEL_SINE_SQUARED * a * c:
        return np.full(2, DEPTH_RANGE_M[1])
    s = (b * (right @ w) - c * (left @ w)) / determinant
    t = (a * (right @ w) - b * (left @ w)) / determinant
    depths = np.array([s, t])
    # lines that diverge meet behind the cameras: take the greatest depth
    return np.clip(np.where(depths > 0.0, depths, DEPTH_RANGE_M[1]), *DEPTH_RANGE_M)


def merge_pair(
    head: HeadModel, pair: SearchedPair, history: JointHistory
) -> tuple[float, FloatArray]:
    """Merge a pair of images into one exposure time, s, and (2, 2) pixels of that time.

    If only one eye has found the target, the time is its own exposure's.
    """
    pixels = np.full((2, 2), np.nan)
    for eye, image in enumerate(pair):
        if image is not None:
            pixels[eye] = image.pixel
    seeing = [one for one in pair if one is not None and np.isfinite(one.pixel).all()]
    if len(seeing) < 2:
        return (seeing[0].exposed_s if seeing else pair.exposed_s), pixels
    exposed = np.stack([history.at(one.exposed_s) for one in seeing])
    return pair.exposed_s, pixels_at_common_time(head, pixels, exposed, history.at(pair.exposed_s))
