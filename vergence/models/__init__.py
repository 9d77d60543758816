"""Head models: kinematics, cameras, limits, presets, and the MuJoCo model made from them."""

from vergence.models.camera import Cameras
from vergence.models.geometry import DenavitHartenberg, JointAxes
from vergence.models.head import HeadModel
from vergence.models.head_file import load_head, parse_head, presets, save_head
from vergence.models.parts import (
    EYE_NAMES,
    EYES,
    JOINTS,
    NECK,
    Actuation,
    Actuators,
    JointLimits,
    LoopTiming,
    Rendering,
    SensorModel,
)
from vergence.models.perturbation import ModelErrors
from vergence.models.posture import LookAt, look_at

__all__ = [
    "EYES",
    "EYE_NAMES",
    "JOINTS",
    "NECK",
    "Actuation",
    "Actuators",
    "Cameras",
    "DenavitHartenberg",
    "HeadModel",
    "JointAxes",
    "JointLimits",
    "LookAt",
    "LoopTiming",
    "ModelErrors",
    "Rendering",
    "SensorModel",
    "load_head",
    "look_at",
    "parse_head",
    "presets",
    "save_head",
]
