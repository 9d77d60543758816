"""Render a calibration target as a camera images it, and detect targets in images."""

from vergence.models.april_grid import AprilGrid
from vergence.models.board_text import parse_target
from vergence.models.boards import (
    AprilTag,
    CharucoBoard,
    Checkerboard,
    PlanarTarget,
    TagFamily,
    Target,
    make_planar_target,
)
from vergence.vision.detection import Detection, Detector
from vergence.vision.detectors import make_detector
from vergence.vision.drawing import TargetRenderer
from vergence.vision.image import as_grey, read_image
from vergence.vision.optics import EyeCamera
from vergence.vision.tags.detector import TagDetector
from vergence.vision.tracking import Tracker

__all__ = [
    "AprilGrid",
    "AprilTag",
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
