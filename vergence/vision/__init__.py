"""From images to pixels: drawing the target as a camera sees it, and detecting it."""

from vergence.models.boards import AprilTag, Checkerboard, PlanarTarget, make_planar_target
from vergence.vision.detection import (
    CheckerboardDetector,
    Detection,
    Detector,
    TagDetector,
    make_detector,
)
from vergence.vision.drawing import TargetDrawing
from vergence.vision.optics import EyeCamera
from vergence.vision.tracking import Tracker

__all__ = [
    "AprilTag",
    "Checkerboard",
    "CheckerboardDetector",
    "Detection",
    "Detector",
    "EyeCamera",
    "PlanarTarget",
    "TagDetector",
    "TargetDrawing",
    "Tracker",
    "make_detector",
    "make_planar_target",
]
