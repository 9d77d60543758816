"""Make a detector for a target, and track a target from image to image."""

from math import hypot, isfinite, nan
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError
from vergence.kernels import compiled
from vergence.models.camera import Camera, CameraResponse
from vergence.models.lens import camera_at, is_distorted, pinhole_ray, ray_to_pixel, undistort_ray
from vergence.models.parts import FloatArray
from vergence.vision.april_grid import AprilGridDetector
from vergence.vision.charuco import CharucoDetector
from vergence.vision.checkerboards import CheckerboardDetector
from vergence.vision.detection import Detection, Detector, as_pixel
from vergence.vision.tag_families import AprilGrid
from vergence.vision.tags.detector import TagDetector
from vergence.vision.targets import AprilTag, CharucoBoard, Checkerboard, TagFamily, Target

_DEFAULT_DEPTH_M: Final = 1.0
"""Depth of a target of unknown size, m; scales the image motion by a camera's translation, not by
its rotation (chosen: a usual working distance)."""
_LEAST_DEPTH_RATIO: Final = 0.05
"""Least depth of a predicted corner, as a ratio to the target's; a smaller one is beside or behind
the camera (chosen)."""
_ROTATION_TOLERANCE: Final = 1e-3
"""Tolerance on the products of a rotation's rows (chosen: accepts rounded poses)."""


@compiled
def _is_rigid_transform(pose: FloatArray) -> bool:
    """True if a (4, 4) matrix has a rotation at its upper left and a finite translation."""
    for i in range(3):
        for j in range(3):
            product = 0.0
            for k in range(3):
                product += pose[i, k] * pose[j, k]
            if not abs(product - (1.0 if i == j else 0.0)) <= _ROTATION_TOLERANCE:
                return False
    handed = 0.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        handed += pose[0, i] * (pose[1, j] * pose[2, k] - pose[1, k] * pose[2, j])
    return handed > 0.0 and isfinite(pose[0, 3] + pose[1, 3] + pose[2, 3])


@compiled
def _predict_target_pixels(
    pixels: FloatArray, packed_camera: FloatArray, T_0_C_before: FloatArray, T_0_C_now: FloatArray,
    corners_m: FloatArray, out: FloatArray,
) -> bool:  # fmt: skip
    """Predict the (n + 1, 2) pixels, px, of a target's corners and point at rest at another pose.

    Corners that were not detected are nan. `corners_m` is (0, 2) if the size is unknown. True if
    the point is predicted inside the lens model and every corner is in front of the camera.
    """
    camera = camera_at(packed_camera, 0)
    count = len(pixels)
    for k in range(count):
        x, y = pinhole_ray(camera, pixels[k, 0], pixels[k, 1])
        if is_distorted(camera):
            x, y = undistort_ray(camera, x, y)
        out[k, 0], out[k, 1] = x, y
    depth_m, first, last = _DEFAULT_DEPTH_M, -1, -1
    for k in range(len(corners_m)):
        if isfinite(out[k, 0]):
            first, last = k if first < 0 else first, k
    if first < last:
        apart = hypot(out[last, 0] - out[first, 0], out[last, 1] - out[first, 1])
        apart_m = hypot(
            corners_m[last, 0] - corners_m[first, 0], corners_m[last, 1] - corners_m[first, 1]
        )
        depth_m = apart_m / max(apart, 1e-6)
    for k in range(count):
        if not isfinite(out[k, 0]):
            out[k, 0] = out[k, 1] = nan
            continue
        x, y, z = 0.0, 0.0, 0.0
        for i in range(3):
            a = T_0_C_before[i, 0] * out[k, 0] + T_0_C_before[i, 1] * out[k, 1] + T_0_C_before[i, 2]
            a += (T_0_C_before[i, 3] - T_0_C_now[i, 3]) / depth_m
            x, y, z = x + T_0_C_now[i, 0] * a, y + T_0_C_now[i, 1] * a, z + T_0_C_now[i, 2] * a
        if z < _LEAST_DEPTH_RATIO:
            return False
        out[k, 0], out[k, 1] = ray_to_pixel(camera, x / z, y / z)
    return isfinite(out[count - 1, 0])


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
        """Corners and point, (n + 1, 2) px, corrected for the camera's own motion if possible."""
        camera = self.detector.camera
        pixels = np.concatenate([last.corners_px, last.point_px[None]])
        if camera is None or pose is None or self._pose is None:
            return pixels
        corners_m = last.target.corners_m if last.target.size_known else _NO_CORNERS_M
        out = np.empty(pixels.shape)
        known = _predict_target_pixels(pixels, camera.row, self._pose, pose, corners_m, out)
        return out if known else pixels


def _pose(value: ArrayLike) -> NDArray[np.float64]:
    try:
        pose = np.array(value, float, order="C")
    except (TypeError, ValueError):
        pose = np.empty(0)
    if pose.shape != (4, 4) or not _is_rigid_transform(pose):
        got = " ".join(repr(value).split())[:120]
        raise ConfigurationError(f"T_0_C: expected a pose (4, 4) with a rotation, got {got}")
    return pose


def make_detector(
    target: Target, camera: Camera | None = None, response: CameraResponse | None = None
) -> Detector[Any]:
    """Make the detector of a target.

    Args:
        target: target to find, see `parse_target`.
        camera: intrinsics of the eye: its lens is modelled, and images must have its size. None
            for images of any size from a pinhole; lens distortion then biases the centre of a tag
            and the corners of a bent tag a little.
        response: light by grey level, see `parse_response`; None for the camera's response or, if
            it has none, a default by whether an image has colours, see `default_response`.

    Raises:
        ConfigurationError: the target or the response is invalid.
    """
    if isinstance(target, Checkerboard):
        return CheckerboardDetector(target, camera, response)
    if isinstance(target, CharucoBoard):
        return CharucoDetector(target, camera, response)
    if isinstance(target, AprilGrid):
        return AprilGridDetector(target, camera, response)
    if isinstance(target, AprilTag | TagFamily):
        return TagDetector(target, camera, response)
    raise ConfigurationError(
        f"target: expected a target, as parse_target makes of text, got {target!r:.80}"
    )
