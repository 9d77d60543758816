"""Following a target through one eye's images: image and prediction in, detection out."""

from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.models.boards import PlanarTarget
from vergence.vision.detection import Detection, Detector
from vergence.vision.optics import EyeCamera

_DEPTH_M: Final = 1.0
"""Of a target whose size is not known; it scales what a camera's translation, not its turning,
does to the image."""
_NEAREST: Final = 0.05
"""Least depth of a predicted corner by the target's: nearer, it is behind the camera or about."""


class Tracker:
    """Looks for a target near where it is expected, and in the whole image if it is not there.

    Where it is expected is, in this order, where the caller says; where it was last seen, carried
    along with the head's own motion if the camera's poses are given; and on from there as it moved
    in the image before.

    Args:
        detector: what finds the target in an image. With a camera, poses can be given.
    """

    def __init__(self, detector: Detector[Any]) -> None:
        self.detector = detector
        self.forget()

    def forget(self) -> None:
        """Lose the track: the next image is searched as a whole."""
        self._last: Detection | None = None
        self._pose: NDArray[np.float64] | None = None
        self._motion = np.zeros(2)

    def find(
        self,
        image: ArrayLike,
        predicted_px: ArrayLike | None = None,
        *,
        T_N_C: ArrayLike | None = None,
        search: bool = True,
    ) -> Detection | None:
        """Find the target in the next image.

        Args:
            image: any that `as_grey` takes.
            predicted_px: (2,) where the measured point is expected; None for where the track says.
            T_N_C: (4, 4) pose of the camera at the exposure, in any frame that does not move, m;
                `head.camera_poses` of the joint readings, with a neck behind `head.base_pose`.
            search: whether to search the whole image where the target is not tracked.

        Returns:
            The detection, with the standard deviations that `triangulate_views` takes as
            ``Noise(pixel_px=...)``; None where nothing can be read.

        Raises:
            ConfigurationError: this is no image, or not of the camera's size.
        """
        pose = None if T_N_C is None else np.asarray(T_N_C, float)
        found = expected = None
        if self._last is not None:
            expected = self._carried(self._last, pose)
            motion = self._motion
            if predicted_px is not None:
                motion = np.asarray(predicted_px, float) - expected.point_px
            found = self.detector.track(image, _moved(expected, motion))
        if found is None and search:
            near = predicted_px if expected is None else expected.point_px
            found = self.detector.search(image, near)
        if found is None:
            self.forget()
            return None
        self._motion = np.zeros(2) if expected is None else found.point_px - expected.point_px
        self._last, self._pose = found, pose
        return found

    def _carried(self, last: Detection, pose: NDArray[np.float64] | None) -> Detection:
        """The last detection where a target at rest appears now that the camera has moved."""
        camera = self.detector.camera
        if camera is None or pose is None or self._pose is None:
            return last
        pixels = np.vstack([last.corners_px, last.point_px])
        moved = np.linalg.solve(pose, self._pose)
        rays = camera.rays(pixels)
        depth = _depth_m(last, camera)
        points = depth * np.column_stack([rays, np.ones(len(rays))]) @ moved[:3, :3].T + moved[:3, 3]
        seen = np.isfinite(points[:, 2])
        if (points[seen, 2] < _NEAREST * depth).any():
            return last
        out = np.full_like(pixels, np.nan)
        out[seen] = camera.project(points[seen])
        if not np.isfinite(out[seen]).all():
            return last
        return last._replace(corners_px=out[:-1], point_px=out[-1])


def _moved(detection: Detection, by_px: NDArray[np.float64]) -> Detection:
    return detection._replace(
        corners_px=detection.corners_px + by_px, point_px=detection.point_px + by_px
    )


def _depth_m(detection: Detection, camera: EyeCamera) -> float:
    """About how far away a target is, by its size."""
    target: PlanarTarget = detection.target
    known = np.flatnonzero(np.isfinite(detection.corners_px[:, 0]))
    if not target.size_known or len(known) < 2:
        return _DEPTH_M
    ends = known[[0, -1]]
    rays = camera.rays(detection.corners_px[ends])
    apart = float(np.linalg.norm(rays[1] - rays[0]))
    return float(np.linalg.norm(np.ptp(target.corners_m[ends], axis=0))) / max(apart, 1e-6)
