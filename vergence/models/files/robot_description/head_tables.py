"""Tables of an imported head's file: poses, limits, motors, and assumed timing and sensors."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from vergence.errors import ConfigurationError
from vergence.models.files.head_rules import LENGTH
from vergence.models.files.robot_description.actuators import EyeMotor, MotionLimits
from vergence.models.files.robot_description.head_chains import HeadChains
from vergence.models.parts import FloatArray


def pose_fields(position_key: str, pose: FloatArray, name: str) -> dict[str, Any]:
    """Fields of a pose: its position and, unless it is the identity, its rotation."""
    # restore values that only rounding has moved from 0 or 1
    near = np.round(pose)
    clean = np.where(np.abs(pose - near) < 1e-15, near, pose) + 0.0
    if not all(LENGTH[0](float(length)) for length in clean[:3, 3]):
        raise ConfigurationError(
            f"{name}: expected to be less than 3 m from what carries it, got "
            f"{np.linalg.norm(clean[:3, 3]):.3g} m: name a --base nearer to the head (or is the "
            "file in millimetres?)"
        )
    fields = {position_key: clean[:3, 3].tolist()}
    if (clean[:3, :3] != np.eye(3)).any():
        fields["rotation"] = clean[:3, :3].tolist()
    return fields


def joint_fields(chains: HeadChains, joint: str) -> dict[str, Any]:
    """Fields of a joint's table in `[[joints]]`, without its limits."""
    found = chains.joint(joint)
    return {
        "name": joint,
        "part": chains.moved_part_of_joint[joint],
        **pose_fields("origin_m", found.origin, f"joint {joint}"),
        "axis": (found.joint.axis + 0.0).tolist(),
    }


def limit_fields(limits: MotionLimits) -> dict[str, float]:
    """Fields of the limits of a joint or an actuator."""
    return {
        "lower_rad": float(limits.lower),
        "upper_rad": float(limits.upper),
        "velocity_rad_s": float(limits.velocity),
        "acceleration_rad_s2": float(limits.acceleration),
    }


def actuator_fields(motors: Sequence[EyeMotor]) -> dict[str, Any]:
    """Tables of actuators; empty if each joint has its own."""
    if not motors:
        return {}
    offsets = {joint: offset for motor in motors for joint, offset in motor.joint_offsets.items()}
    tables: dict[str, Any] = {
        "actuators": [
            {"name": motor.name, "joints": dict(motor.joint_factors), **limit_fields(motor.limits)}
            for motor in motors
        ]
    }
    return tables | ({"joint_offsets_rad": offsets} if offsets else {})


ASSUMED_LOOP: Final[dict[str, Any]] = {
    "timing": {
        "control_rate_hz": 120.0,
        "frame_rate_hz": 60.0,
        "latency_s": 8 / 120,
        "exposure_s": 0.0,
        "lag_s": 0.03,
    },
    "sensor": {
        "detection_noise_px": 0.05,
        "encoder_resolution_rad": 0.0,
        "velocity_resolution_rad_s": 0.0,
        "dropped_frame_probability": 0.0,
        "max_smear_px": 6.0,
    },
    "rendering": {
        "blur_px": 0.5,
        "noise_grey": 2.0,
        "supersampling": 1,
        "black_grey": 40.0,
        "white_grey": 210.0,
        "background_grey": 120.0,
    },
}
"""Assumed values for the parts of a head that a robot description does not contain."""
LOOP_REASONS: Final = {
    "timing.control_rate_hz": "not in such a file: what a servo bus of few joints reaches",
    "timing.frame_rate_hz": "not in such a file: that of common USB cameras",
    "timing.latency_s": "not in such a file: that of a USB camera with detection, 67 ms",
    "timing.exposure_s": "not in such a file: a short one in good light",
    "timing.lag_s": "not in such a file: that of common servos, 30 ms",
    "sensor": "not in such a file: detection as in docs/vision.md, ideal encoders, no lost images",
    "rendering": "not in such a file: how simulated images look, that of the simulated preset",
}
"""Reason for the assumed values by key of the head file."""
