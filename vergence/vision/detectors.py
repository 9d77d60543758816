"""The detector of each kind of target."""

from typing import Any

from vergence.errors import ConfigurationError
from vergence.models.april_grid import AprilGrid
from vergence.models.boards import AprilTag, CharucoBoard, Checkerboard, TagFamily, Target
from vergence.models.response import Response
from vergence.vision.boards.april_grid import AprilGridDetector
from vergence.vision.boards.charuco import CharucoDetector
from vergence.vision.boards.checkerboards import CheckerboardDetector
from vergence.vision.detection import Detector
from vergence.vision.optics import EyeCamera
from vergence.vision.tags.detector import TagDetector


def make_detector(
    target: Target, camera: EyeCamera | None = None, response: Response | None = None
) -> Detector[Any]:
    """The detector of a target.

    Args:
        target: what to look for, see `parse_target`.
        camera: the eye's intrinsics: its lens is taken into account, and images must have its size.
            Without it images are taken for a pinhole's, which places the centre of a tag and the
            corners of a bent one a little beside; any size will do.
        response: light by grey level, see `parse_response`; None for the camera's, or where that
            has none by the kind of each image, see `default_response`.

    Raises:
        ConfigurationError: this is no target, or no response.
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
