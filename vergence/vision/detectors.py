"""Detector for each kind of target."""

from typing import Any

from vergence.errors import ConfigurationError
from vergence.models.camera import Camera, CameraResponse
from vergence.vision.boards.april_grid import AprilGridDetector
from vergence.vision.boards.charuco import CharucoDetector
from vergence.vision.boards.checkerboards import CheckerboardDetector
from vergence.vision.detection import Detector
from vergence.vision.tag_families import AprilGrid
from vergence.vision.tags.detector import TagDetector
from vergence.vision.targets import AprilTag, CharucoBoard, Checkerboard, TagFamily, Target


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
