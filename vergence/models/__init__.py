"""What the head is: kinematics, cameras, limits, presets, and the MuJoCo model made from them."""

from vergence.models.files.head_file import load_head, presets, save_head
from vergence.models.files.head_toml import parse_head
from vergence.models.head import HeadModel
from vergence.models.joints import EYE_NAMES, EYES, JOINTS, NECK
from vergence.models.parts import (
    Cameras,
    DenavitHartenberg,
    JointLimits,
    LoopTiming,
    Rendering,
    SensorModel,
)
from vergence.models.perturbation import ModelErrors

__all__ = [
    "EYES",
    "EYE_NAMES",
    "JOINTS",
    "NECK",
    "Cameras",
    "DenavitHartenberg",
    "HeadModel",
    "JointLimits",
    "LoopTiming",
    "ModelErrors",
    "Rendering",
    "SensorModel",
    "load_head",
    "parse_head",
    "presets",
    "save_head",
]
