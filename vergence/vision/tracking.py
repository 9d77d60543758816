"""Following a target through one eye's images: image and prediction in, detection out."""

from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError
from vergence.vision.carrying import carry, is_pose
from vergence.vision.detection import Detection, Detector, as_pixel

_UNKNOWN_M: Final = np.empty((0, 2))


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
            image: any that `as_grey` takes.
            predicted_px: (2,) where the measured point is expected; None for where the track says.
            T_0_C: (4, 4) pose of the camera at the exposure in a frame that does not move, m:
                `head.base_pose(q) @ head.camera_poses(q)` of one eye, by the joints' readings.
            search: whether to search the whole image where the target is not tracked.

        Returns:
            The detection, with the standard deviations that `triangulate_views` takes as
            ``Noise(pixel_px=...)``; None where nothing can be read.

        Raises:
            ConfigurationError: this is no image, or not of the camera's size; a prediction that is
                no pixel; a pose that is none.
        """
        pose = None if T_0_C is None else _pose(T_0_C)
        predicted_px = None if predicted_px is None else as_pixel("predicted_px", predicted_px)
        found = carried_px = None
        if self._last is not None:
            pixels = self._carried(self._last, pose)
            carried_px = pixels[-1]
            pixels = pixels + (self._motion if predicted_px is None else predicted_px - carried_px)
            expected = self._last._replace(corners_px=pixels[:-1], point_px=pixels[-1])
            found = self.detector.track(image, expected)
        if found is None and search:
            near = predicted_px if carried_px is None else carried_px
            # all ways in the image in which it was lost, then one an image: searching takes time
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

    def _carried(self, last: Detection, pose: NDArray[np.float64] | None) -> NDArray[np.float64]:
        """Where the last detection's corners and point appear now that the camera has moved.

        Returns:
            (n + 1, 2) px, of a target at rest; where they were if this cannot be told.
        """
        camera = self.detector.camera
        pixels = np.concatenate([last.corners_px, last.point_px[None]])
        if camera is None or pose is None or self._pose is None:
            return pixels
        corners_m = last.target.corners_m if last.target.size_known else _UNKNOWN_M
        out = np.empty(pixels.shape)
        return out if carry(pixels, camera.row, self._pose, pose, corners_m, out) else pixels


def _pose(value: ArrayLike) -> NDArray[np.float64]:
    try:
        pose = np.array(value, float, order="C")
    except (TypeError, ValueError):
        pose = np.empty(0)
    if pose.shape != (4, 4) or not is_pose(pose):
        raise ConfigurationError(
            f"T_0_C: expected a pose (4, 4) with a rotation, got {_in_a_line(value)}"
        )
    return pose


def _in_a_line(value: object) -> str:
    return " ".join(repr(value).split())[:120]
