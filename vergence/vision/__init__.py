"""Render a calibration target as a camera images it, and detect targets in images."""

from vergence.models.camera import Camera
from vergence.vision.detection import BoardDetection, BoardDetector, Detection, Detector
from vergence.vision.drawing import TargetRenderer
from vergence.vision.image import as_grey, read_image
from vergence.vision.tag_families import AprilGrid
from vergence.vision.tags.detector import TagDetector
from vergence.vision.targets import (
    AprilTag,
    CharucoBoard,
    Checkerboard,
    PlanarTarget,
    TagFamily,
    Target,
    make_planar_target,
    parse_target,
)
from vergence.vision.tracking import Tracker, make_detector

EyeCamera = Camera
"""Former name of `Camera`."""

__all__ = [
    "AprilGrid",
    "AprilTag",
    "BoardDetection",
    "BoardDetector",
    "Camera",
    "CharucoBoard",
    "Checkerboard",
    "Detection",
    "Detector",
    "EyeCamera",
    "PlanarTarget",
    "TagDetector",
    "TagFamily",
    "Target",
    "TargetRenderer",
    "Tracker",
    "as_grey",
    "make_detector",
    "make_planar_target",
    "parse_target",
    "read_image",
]
