"""Import of a head from a robot's URDF or MJCF, as the text of a head file."""

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from vergence.errors import ConfigurationError, HeadFileError
from vergence.models.files.head_rules import LENGTH, NAME
from vergence.models.files.head_toml import check_head_name, parse_head
from vergence.models.files.intrinsics import Lens
from vergence.models.files.joints_toml import frame_between_cameras
from vergence.models.files.robot_description.actuators import (
    Coupling,
    EyeJoint,
    EyeMotor,
    MotionLimits,
    find_eye_motors,
)
from vergence.models.files.robot_description.camera_axes import (
    MUJOCO_AXES,
    OPTICAL_AXES,
    EyeAtZeroAngles,
    check_camera_axes,
    rotation_of_axes,
)
from vergence.models.files.robot_description.given import parse_locked_joints
from vergence.models.files.robot_description.head_chains import HeadChains, build_head_chains
from vergence.models.files.robot_description.image import find_eye_intrinsics
from vergence.models.files.robot_description.limits import joint_motion_limits
from vergence.models.files.robot_description.mechanism import Mechanism
from vergence.models.files.robot_description.reader import read_mechanism
from vergence.models.files.toml_text import toml_text
from vergence.models.head import HeadModel
from vergence.models.joints import EYE_NAMES
from vergence.models.parts import FloatArray


@dataclass(frozen=True, kw_only=True)
class UrdfSource:
    """A robot description, and the frames and joints of it that make up the head.

    Attributes:
        file: URDF or MJCF.
        base: frame that the neck is mounted on.
        cameras: frames of the left and the right camera.
        neck: up to three neck joints.
        lock: `JOINT=DEG` for joints held at an angle; `JOINT=0.1m` for prismatic joints.
        camera_axes: `right,down,forward` axes of the camera frames, one for both or one each; empty
            if the frames are optical frames or cameras of an MJCF.
        speed: `RAD_S` for joints without a speed limit, `JOINT=RAD_S` for one.
        acceleration: `RAD_S2` for all joints, `JOINT=RAD_S2` for one.
        couplings: motors that move both eyes but are missing in the file.
        intrinsics: files with the cameras' calibration.
        size: (width, height) in pixels, for calibration files that do not give it.
        lens: lens model, for calibration files that do not name it.
        name: name of the head; empty for the robot's name.
    """

    file: str | os.PathLike[str]
    base: str
    cameras: tuple[str, str]
    neck: Sequence[str] = ()
    lock: Sequence[str] = ()
    camera_axes: Sequence[str] = ()
    speed: Sequence[str] = ()
    acceleration: Sequence[str] = ()
    couplings: Sequence[Coupling] = ()
    intrinsics: Sequence[str | os.PathLike[str]] = ()
    size: tuple[int, int] | None = None
    lens: Lens | None = None
    name: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class ImportedHead:
    """A head imported from a robot description.

    Attributes:
        head: the head, parsed from the text.
        text: text of the head file.
        chains: the kinematic chains of the head in the robot description.
        motors: motors of the eyes; empty if each joint has its own.
        ignored: parts of the robot that the head leaves out, one phrase each.
        guesses: doubtful or assumed values of the cameras' calibration, one phrase each.
    """

    head: HeadModel
    text: str
    chains: HeadChains
    motors: Sequence[EyeMotor]
    ignored: Sequence[str]
    guesses: Sequence[str]


def import_urdf(source: UrdfSource) -> ImportedHead:
    """Build a head from two cameras of a robot and the joints that move them.

    Locked joints become part of the fixed poses between moving joints. Frame N follows the head
    file's default rule: fixed to the link of the last neck joint, midway between the cameras with
    all joints at zero.

    Args:
        source: the file, and the selection of frames and joints.

    Raises:
        UnreadableFileError: the file cannot be read.
        HeadFileError: what it describes cannot be a head.
        ConfigurationError: the selection is wrong, or a head file cannot express it.
    """
    mechanism = read_mechanism(source.file)
    base = mechanism.find_frame(source.base, "base", ("body", "site", "camera"))
    cameras = tuple(
        mechanism.find_frame(name, f"{eye}-camera", ("camera", "site", "body"))
        for eye, name in zip(EYE_NAMES, source.cameras, strict=True)
    )
    _check_two(source.cameras)
    chains = build_head_chains(
        mechanism,
        base=base,
        cameras=(cameras[0], cameras[1]),
        neck=source.neck,
        locked=parse_locked_joints(source.lock, mechanism.joints()),
    )
    axes = _axes(mechanism, cameras, source.camera_axes)
    zero = dict.fromkeys(chains.moved_part_of_joint, 0.0)
    eyes = [
        EyeAtZeroAngles(
            name=name,
            pose=chain.pose(zero) @ _turned(rotation),
            joint_axes=chain.axes(
                [n for n, part in chains.moved_part_of_joint.items() if part != "neck"]
            ),
        )
        for name, chain, rotation in zip(source.cameras, chains.chains, axes, strict=True)
    ]
    joints = [joint_fields(chains, name) for name in chains.moved_part_of_joint]
    mounts = [
        pose_fields("position_m", chain.camera_in_last_link @ _turned(rotation), f"{eye} camera")
        for eye, chain, rotation in zip(EYE_NAMES, chains.chains, axes, strict=True)
    ]
    if not source.camera_axes:
        root = mechanism.pose(0, base, {**zero, **chains.fixed_values})
        check_camera_axes(eyes, up=root[:3, 2])
    ranges, assumed = joint_motion_limits(
        [chains.joint(name).joint for name in chains.moved_part_of_joint],
        source.speed,
        source.acceleration,
    )
    moved = _motors(chains, eyes, ranges, source.couplings)
    assumed = _of_motors(assumed, moved)
    calibrated, why = find_eye_intrinsics(
        [mechanism.frames[camera].camera for camera in cameras],
        source.intrinsics,
        size=source.size,
        lens=source.lens,
    )
    images = (calibrated.left, calibrated.right)
    one_size = images[0].size_fields() == images[1].size_fields()
    if one_size:
        size = re.compile(r"eyes\.\w+\.(?=width_px|height_px)")
        why = {size.sub("image.", key): reason for key, reason in why.items()}
    document = {
        "name": _name(source, mechanism),
        **({"image": images[0].size_fields()} if one_size else {}),
        **ASSUMED_LOOP,
        # limits belong to the motors: those of joints with shared motors follow from them
        "joints": [
            joint
            if moved and joint["part"] != "neck"
            else joint | limit_fields(ranges[joint["name"]])
            for joint in joints
        ],
        "eyes": [
            {
                "name": eye,
                **({} if one_size else image.size_fields()),
                **image.fields(),
                **mount,
            }
            for eye, image, mount in zip(EYE_NAMES, images, mounts, strict=True)
        ],
        **actuator_fields(moved),
        "assumptions": {**why, **LOOP_REASONS, **assumed},
    }
    text = _heading(source, mechanism, chains) + toml_text(document)
    return ImportedHead(
        head=_parsed(text),
        text=text,
        chains=chains,
        motors=moved,
        ignored=_ignored(mechanism, chains),
        guesses=calibrated.guesses if source.intrinsics else (),
    )


def _check_two(cameras: tuple[str, str]) -> None:
    """Refuse one camera given twice, and the colour and depth frames of one device."""
    left, right = cameras
    if left == right or ("depth" in left.lower()) != ("depth" in right.lower()):
        raise ConfigurationError(
            f"left-camera, right-camera: expected frames of two cameras, got {left} and {right}: "
            "vergence needs two cameras, and a colour and a depth frame of one device are not two"
        )


def _axes(
    mechanism: Mechanism, cameras: Sequence[int], triples: Sequence[str]
) -> tuple[FloatArray, ...]:
    """(3, 3) rotation of each camera in its frame, R_frame_camera."""
    if len(triples) > 2:
        raise ConfigurationError(
            f"camera-axes: expected one for both cameras or one for each, got {len(triples)}"
        )
    if triples:
        return rotation_of_axes(triples[0]), rotation_of_axes(triples[-1])
    kinds = [mechanism.frames[camera].kind for camera in cameras]
    return tuple(
        rotation_of_axes(MUJOCO_AXES if kind == "camera" else OPTICAL_AXES) for kind in kinds
    )


def _turned(rotation: FloatArray) -> FloatArray:
    pose = np.eye(4)
    pose[:3, :3] = rotation
    return pose


def _motors(
    chains: HeadChains,
    eyes: Sequence[EyeAtZeroAngles],
    ranges: Mapping[str, MotionLimits],
    couplings: Sequence[Coupling],
) -> list[EyeMotor]:
    """Motors of the eyes; empty if each joint has its own."""
    if not chains.mimic_joints and not couplings:
        return []
    between = frame_between_cameras(np.stack([eye.pose for eye in eyes]))
    joints = []
    for name, part in chains.moved_part_of_joint.items():
        if part != "neck":
            axis = chains.axis(name) @ between[:3, :3]
            joints.append(EyeJoint(name=name, moved_eyes=part, axis=axis, limits=ranges[name]))
    baseline = float(np.linalg.norm(eyes[1].pose[:3, 3] - eyes[0].pose[:3, 3]))
    return find_eye_motors(joints, chains.mimic_joints, couplings, baseline)


def _of_motors(assumed: Mapping[str, str], moved: Sequence[EyeMotor]) -> dict[str, str]:
    """Assumption keys and reasons, moved from joints to the motors that drive them, if any."""
    found: dict[str, str] = {}
    for key, why in assumed.items():
        joint, _, field = key.removeprefix("joints.").rpartition(".")
        movers = [motor for motor in moved if joint in motor.joint_factors]
        for motor in movers:
            found.setdefault(f"actuators.{motor.name}.{field}", why)
        if not movers:
            found[key] = why
    for motor in moved:
        if motor.assumption_reason:
            found |= {
                f"actuators.{motor.name}.{end}": motor.assumption_reason
                for end in motor.assumed_keys
            }
    return found


def _name(source: UrdfSource, mechanism: Mechanism) -> str:
    if source.name:
        check_head_name(source.name)
        return source.name
    for name in (mechanism.name, Path(source.file).stem):
        fitted = re.sub(r"[^\w.-]+", "_", name).strip("_.-")[:64]
        if NAME[0](fitted):
            return fitted
    return "head"


def _heading(source: UrdfSource, mechanism: Mechanism, chains: HeadChains) -> str:
    lines = [
        f"The head of {mechanism.name or 'a robot'} in {Path(source.file).name}, from "
        f"{source.base} to the cameras {source.cameras[0]} and {source.cameras[1]}."
    ]
    if chains.fixed_values:
        held = (f"{name} at {value:.6g}" for name, value in chains.fixed_values.items())
        lines.append(f"Held, in rad or m: {', '.join(held)}.")
    lines.append("What the file lacks is assumed: see [assumptions].")
    return "".join(f"# {_printable(line)}\n" for line in lines)


def _printable(text: str) -> str:
    return "".join(c if c.isprintable() else "?" for c in text)


def _parsed(text: str) -> HeadModel:
    try:
        return parse_head(text)
    except HeadFileError as error:
        raise HeadFileError(
            error.key, error.value, error.expected, "the head of this file"
        ) from error


def _ignored(mechanism: Mechanism, chains: HeadChains) -> list[str]:
    moved = chains.moved_part_of_joint
    ties = [
        f"{name} (ties {', '.join(joints)}: see --actuators)"
        for name, joints in mechanism.left_out
        if not moved.keys().isdisjoint(joints)
    ]
    bodies = [name for name, joints in mechanism.left_out if not joints]
    if bodies:
        more = f" and {len(bodies) - 1} more" if len(bodies) > 1 else ""
        ties.append(f"{bodies[0]}{more}, which may tie bodies")
    others = len(mechanism.joints()) - len(chains.moved_part_of_joint) - len(chains.fixed_values)
    return [
        *ties,
        *([f"{others} other joints"] if others else []),
        "shapes, masses, friction, efforts",
        "cameras and plugins of simulators other than MuJoCo",
    ]


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
