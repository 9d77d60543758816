"""The detector of each kind of target."""
from typing import Any
from vergence.models.boards import AprilTag, TagFamily
from vergence.vision.tags import TagDetector
def make_detector(target: Any, camera: Any = None) -> Any:
    return TagDetector(target, camera)
