"""Track a target through one eye's images: image and prediction in, detection out."""

from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError
from vergence.vision.detection import Detection, Detector, as_pixel
from vergence.vision.motion_prediction import is_rigid_transform, predict_target_pixels

_NO_CORNERS_M: Final = np.empty((0, 2))
"""Corners of a target of unknown size (numerical)."""


class Tracker:
    """Tracks a target near its predicted position, and searches the whole image if it is not there.

    The caller may give the prediction. Otherwise it is the last detection, corrected for the
    camera's own motion if poses are given, plus the target's last displacement in the image.

    Args:
        detector: detector of the target; poses are used only if it has a camera.
    """

    def __init__(self, detector: Detector[Any]) -> None:
        self.detector = detector
        self.forget()

    def forget(self) -> None:
        """Drop the track, so that the next image is searched as a whole."""
        self._last: Detection | None = None
        self._pose: NDArray[np.float64] | None = None
        self._motion = np.zeros(2)
        self._lost = 0

    def find(
        self,
        image: ArrayLike,
        predicted_px: ArrayLike | None = None,
        *,
        T_0_C: ArrayLike | None = None,
        search: bool = True,
    ) -> Detection | None:
        """Find the target in the next image.

        Args:
            image: an image in any form that `as_grey` accepts.
            predicted_px: (2,) predicted position of the measured point; None for the prediction of
                the track.
            T_0_C: (4, 4) pose of the camera at the exposure in a fixed frame, m:
                `head.base_pose(q) @ head.camera_poses(q)` of one eye at the measured joint angles.
            search: true to search the whole image if tracking fails.

        Returns:
            The detection, with the standard deviations that `triangulate_views` takes as
            ``Noise(pixel_px=...)``; None if no target can be read.

        Raises:
            ConfigurationError: the image is invalid, or not of the camera's size; the prediction
                is not a pixel; the pose is invalid.
        """
        pose = None if T_0_C is None else _pose(T_0_C)
        predicted_px = None if predicted_px is None else as_pixel("predicted_px", predicted_px)
        found = carried_px = None
        if self._last is not None:
            pixels = self._predict_rest(self._last, pose)
            carried_px = pixels[-1]
            pixels = pixels + (self._motion if predicted_px is None else predicted_px - carried_px)
            expected = self._last._replace(corners_px=pixels[:-1], point_px=pixels[-1])
            found = self.detector.track(image, expected)
        if found is None and search:
            near = predicted_px if carried_px is None else carried_px
            # all methods in the image that lost it, then one per image, to save time
            found = self.detector.search(image, near, self._lost - 1 if self._lost else None)
        if found is None:
            lost = self._lost + search
            self.forget()
            self._lost = lost
            return None
        self._lost = 0
        self._motion = np.zeros(2) if carried_px is None else found.point_px - carried_px
        self._last, self._pose = found, pose
        return found

    def _predict_rest(
        self, last: Detection, pose: NDArray[np.float64] | None
    ) -> NDArray[np.float64]:
        """Corners and point of the last detection, corrected for the camera's own motion.

        Returns:
            (n + 1, 2) pixels of a target at rest, px; uncorrected if this is not possible.
        """
        camera = self.detector.camera
        pixels = np.concatenate([last.corners_px, last.point_px[None]])
        if camera is None or pose is None or self._pose is None:
            return pixels
        corners_m = last.target.corners_m if last.target.size_known else _NO_CORNERS_M
        out = np.empty(pixels.shape)
        return (
            out
            if predict_target_pixels(pixels, camera.row, self._pose, pose, corners_m, out)
            else pixels
        )


def _pose(value: ArrayLike) -> NDArray[np.float64]:
    try:
        pose = np.array(value, float, order="C")
    except (TypeError, ValueError):
        pose = np.empty(0)
    if pose.shape != (4, 4) or not is_rigid_transform(pose):
        raise ConfigurationError(
            f"T_0_C: expected a pose (4, 4) with a rotation, got {_in_a_line(value)}"
        )
    return pose


def _in_a_line(value: object) -> str:
    return " ".join(repr(value).split())[:120]
