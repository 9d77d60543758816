"""A head from a robot's URDF or MJCF."""

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations, product
from math import radians, tan
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from vergence.errors import HeadFileError
from vergence.models.assumed import ROBOT, ROBOT_REASONS
from vergence.models.camera import Camera, camera_matrix
from vergence.models.head import HeadModel
from vergence.models.head_file import (
    NAME,
    camera_fields,
    check_head_name,
    eye_tables,
    head_of_document,
)
from vergence.models.head_joints import LENGTH
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.models.stereo_files import ReadCameras, read_intrinsics
from vergence.models.toml_table import toml_text
from vergence.models.urdf.chains import ChainJoint, HeadChains, build_head_chains
from vergence.models.urdf.mechanism import Frame, Mechanism, MjcfCamera, read_mechanism, refuse
from vergence.models.urdf.motors import Coupling, EyeMotor, find_eye_motors, joint_motion_limits


@dataclass(frozen=True, kw_only=True)
class UrdfSource:
    """A robot description, and the frames and joints of it that make up the head."""

    file: str | os.PathLike[str]  # URDF or MJCF
    base: str  # frame that the neck is mounted on
    cameras: tuple[str, str]  # frames of the left and the right camera
    neck: Sequence[str] = ()  # up to three joints
    lock: Sequence[str] = ()  # `JOINT=DEG` for joints held there, `JOINT=0.1m` for prismatic ones
    camera_axes: Sequence[str] = ()  # `right,down,forward`, one for both or each; else the usual
    speed: Sequence[str] = ()  # `RAD_S` for joints without a limit, `JOINT=RAD_S` for one
    acceleration: Sequence[str] = ()  # `RAD_S2` for all joints, `JOINT=RAD_S2` for one
    couplings: Sequence[Coupling] = ()  # motors of both eyes that the file lacks
    intrinsics: Sequence[str | os.PathLike[str]] = ()  # files with the cameras' calibration
    size: tuple[int, int] | None = None  # width and height, px, for such files without it
    lens: str | None = None  # for such files that do not name it
    name: str = ""  # of the head; empty for the robot's


@dataclass(frozen=True, kw_only=True, eq=False)
class ImportedHead:
    """A head imported from a robot description."""

    head: HeadModel
    text: str  # of the head file
    chains: HeadChains
    motors: Sequence[EyeMotor]  # of the eyes; empty if each joint has its own
    ignored: Sequence[str]  # parts of the robot that the head leaves out, one phrase each
    guesses: Sequence[str]  # doubts about the cameras' calibration, one phrase each


def import_urdf(source: UrdfSource) -> ImportedHead:
    """Build a head from two cameras of a robot and the joints that move them.

    Locked joints become part of the fixed poses between moving joints. Frame N follows the head
    file's default rule: fixed to the link of the last neck joint, midway between the cameras with
    all joints at zero.
    """
    mechanism = read_mechanism(source.file)
    base = mechanism.find_frame(source.base, "base", ("body", "site", "camera"))
    cameras = [
        mechanism.find_frame(name, f"{eye}-camera", ("camera", "site", "body"))
        for eye, name in zip(EYE_NAMES, source.cameras, strict=True)
    ]
    frames = [mechanism.frames[camera] for camera in cameras]
    _check_two(*source.cameras)
    chains = build_head_chains(mechanism, (base, *cameras), source.neck, source.lock)
    axes = _axes(frames, source.camera_axes)
    poses = chains.camera_poses @ axes
    joints = [_joint_fields(name, joint) for name, joint in chains.joints.items()]
    mounts = [
        _pose_fields("position_m", mount, f"{eye} camera")
        for eye, mount in zip(EYE_NAMES, chains.mounts @ axes, strict=True)
    ]
    if not source.camera_axes:
        angles = dict.fromkeys(chains.joints, 0.0) | dict(chains.fixed_values)
        base_in_root = mechanism.pose_along(mechanism.ancestors(base), angles)
        _check_camera_axes(source.cameras, poses, chains, up=base_in_root[2, :3])
    moving = [joint.joint for joint in chains.joints.values()]
    limits, assumed = joint_motion_limits(moving, source.speed, source.acceleration)
    motors = find_eye_motors(chains, limits, source.couplings, poses)
    read, unsaid = _images([frame.camera for frame in frames], source)
    if read.left.size == read.right.size:
        size = re.compile(r"eyes\.\w+\.(?=width_px|height_px)")
        unsaid = {size.sub("image.", key): reason for key, reason in unsaid.items()}
    fields = [camera_fields(image) | mount for image, mount in zip(read, mounts, strict=True)]
    tables = eye_tables(read, fields)
    eyes = tables.pop("eyes")
    document = {
        "name": _name(source, mechanism),
        **tables,
        **ROBOT,
        # limits belong to the motors: those of joints with shared motors follow from them
        "joints": [
            joint | ({} if motors and joint["part"] != "neck" else limit.fields())
            for joint, limit in zip(joints, limits.values(), strict=True)
        ],
        "eyes": eyes,
        **_actuator_fields(motors),
        "assumptions": {**unsaid, **ROBOT_REASONS, **_of_motors(assumed, motors)},
    }
    try:
        head = head_of_document(document)
    except HeadFileError as error:
        where = "the head of this file"
        raise HeadFileError(error.key, error.value, error.expected, where) from error
    return ImportedHead(
        head=head,
        text=_heading(source, mechanism, chains) + toml_text(document),
        chains=chains,
        motors=motors,
        ignored=_ignored(mechanism, chains),
        guesses=read.guesses if source.intrinsics else (),
    )


def _check_two(left: str, right: str) -> None:
    """Refuse one camera given twice, and the colour and depth frames of one device."""
    if left == right or ("depth" in left.lower()) != ("depth" in right.lower()):
        why = "vergence needs two cameras, and a colour and a depth frame of one device are not two"
        refuse("left-camera, right-camera", "frames of two cameras", f"{left} and {right}: {why}")


_OPTICAL_AXES: Final = "x,y,z"  # axes of an optical frame: x right, y down, z forward
_MUJOCO_AXES: Final = "x,-y,-z"
"""Axes of MuJoCo's cameras, which look along -z with y up, as in OpenGL."""
_SIGNED: Final = {sign + name: s * np.eye(3)[i] for s, sign in ((1.0, ""), (-1.0, "-"))
                  for i, name in enumerate("xyz")}  # fmt: skip
_ROTATIONS: Final = {
    ",".join(triple): np.column_stack([_SIGNED[axis] for axis in triple])
    for names in permutations("xyz")
    for signs in product(("", "-"), repeat=3)
    for triple in [[sign + name for sign, name in zip(signs, names, strict=True)]]
}
"""(3, 3) R_frame_camera by axes `right,down,forward`; half of them are left-handed."""
_RIGHT_HANDED: Final = [axes for axes, R in _ROTATIONS.items() if np.linalg.det(R) > 0.0]

_ALIGNED_COSINE: Final = np.cos(np.deg2rad(45.0))
"""Cosine of the angle below which an axis counts as aligned with a direction (chosen)."""
_ROLL_AXIS_COSINE: Final = np.cos(np.deg2rad(25.0))
"""Cosine of the angle between optical axis and joint axis below which a joint would roll the
image (chosen: tilted mounts are accepted, wrong frames refused)."""


def _axes(frames: Sequence[Frame], triples: Sequence[str]) -> FloatArray:
    """(2, 4, 4) pose of each camera in its frame, of the given axes or those usual for its kind."""
    if len(triples) > 2:
        refuse("camera-axes", "one for both cameras or one for each", len(triples))
    usual = [_MUJOCO_AXES if frame.kind == "camera" else _OPTICAL_AXES for frame in frames]
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[:, :3, :3] = [_rotation(axes) for axes in (*triples[:1], *triples[-1:]) or usual]
    return poses


def _rotation(right_down_forward: str) -> FloatArray:
    """R_frame_camera, (3, 3), from the axes `right,down,forward`, such as `x,-y,-z`."""
    names = [name.strip().lower().removeprefix("+") for name in right_down_forward.split(",")]
    axes, got = ",".join(names), repr(right_down_forward)
    expected = (
        "the axes of the camera's frame that point right in the image, down in it and forward, "
        "such as x,-y,-z"
    )
    if axes not in _ROTATIONS:
        refuse("camera-axes", expected, got)
    if axes not in _RIGHT_HANDED:
        forward = f"-{names[2]}".removeprefix("--")
        other = f"left-handed ({names[0]},{names[1]},{forward} is not)"
        refuse("camera-axes", f"{expected}, forward being right x down", f"{got}, which is {other}")
    return _ROTATIONS[axes]


class _Eye(NamedTuple):
    """A camera at zero, in the base's frame."""

    rotation: FloatArray  # (3, 3), its columns right, down and forward
    joint_axes: Sequence[FloatArray]  # (3,) of the joints that move this eye


def _check_camera_axes(
    names: Sequence[str], poses: FloatArray, chains: HeadChains, up: FloatArray
) -> None:
    """Refuse cameras unless, at zero, they are side by side, look ahead and are upright."""
    across = poses[1, :3, 3] - poses[0, :3, 3]
    distance = float(np.linalg.norm(across))
    if not distance > 1e-3:
        got = f"{names[0]} and {names[1]}, {1000.0 * distance:.3g} mm apart at zero"
        refuse("cameras", "two that are more than 1 mm apart", got)
    across = across / distance
    turning = chains.eye_joints().values()
    eyes = [
        _Eye(pose[:3, :3], [j.axis_in_base for j in turning if j.part in ("both", side)])
        for side, pose in zip(EYE_NAMES, poses, strict=True)
    ]
    faults = [_fault(eye, across, up) for eye in eyes]
    if not any(faults):
        return
    name, why = next(pair for pair in zip(names, faults, strict=True) if pair[1])
    fitting = [
        min(_RIGHT_HANDED, key=lambda axes: _misfit(eye, _ROTATIONS[axes], across, up))
        for eye in eyes
    ]
    swapped = all(eye.rotation[:, 0] @ across < -_ALIGNED_COSINE for eye in eyes)
    exchanged = "; or the left and the right camera are exchanged" if swapped else ""
    got = f"one whose {why}:"
    if set(fitting) == {_OPTICAL_AXES}:
        way_on = f"check which frames are the cameras (--camera-axes={_OPTICAL_AXES} takes them as"
        way_on = f"{way_on} they are{exchanged})"
        refuse(name, "cameras side by side that look ahead at zero", f"{got} {way_on}")
    text = " ".join(f"--camera-axes={triple}" for triple in dict.fromkeys(fitting))
    way_on = f"{text} would fit ({_OPTICAL_AXES} if it is right as it is{exchanged})"
    refuse(name, "a camera frame with x right, y down and z forward", f"{got} {way_on}")


def _fault(eye: _Eye, across: FloatArray, up: FloatArray) -> str:
    right, down, forward = eye.rotation.T
    cosines = np.array([right @ across, forward @ across])
    x, z = (f"{angle:.0f} degrees" for angle in np.rad2deg(np.arccos(np.clip(cosines, -1.0, 1.0))))
    if cosines[0] < _ALIGNED_COSINE:
        return f"x is {x} from the line from the left camera to the right one"
    if abs(cosines[1]) > _ALIGNED_COSINE:
        return f"z is {z} from the line between the cameras"
    if down @ up > _ALIGNED_COSINE:
        return "y points up"
    if any(abs(forward @ axis) > _ROLL_AXIS_COSINE for axis in eye.joint_axes):
        return "z lies along an axis that the eye turns about"
    return ""


def _misfit(eye: _Eye, rotation: FloatArray, across: FloatArray, up: FloatArray) -> float:
    """Measure of how badly a rotation of the camera in its frame fits."""
    right, down, forward = (eye.rotation @ rotation).T
    rolled = max((abs(float(forward @ axis)) for axis in eye.joint_axes), default=0.0)
    return float(-2.0 * (right @ across) + down @ up + 1.5 * rolled)


_ASSUMED_SIZE_PX: Final = (640, 480)
"""Image size of a camera without a given one, px (chosen: common with webcams)."""
_ASSUMED_FOV_DEG: Final = 60.0
"""Horizontal field of view of a camera without a given one, degrees (chosen)."""


def _images(
    cameras: Sequence[MjcfCamera | None], source: UrdfSource
) -> tuple[ReadCameras, dict[str, str]]:
    """Intrinsics of both eyes, files before cameras, and reasons of assumptions by dotted key."""
    for eye, camera in zip(EYE_NAMES, cameras, strict=True):
        if camera is not None and camera.fault:
            expected = "a camera that is fixed to its body and sees in perspective"
            refuse(f"{eye}-camera", expected, f"one that {camera.fault}")
    if source.intrinsics:
        read = read_intrinsics(source.intrinsics, size=source.size, lens=source.lens)
        assumed = read.assumed
        if read.left is read.right:
            assumed["eyes.right.focal_px"] = "one calibration was given for both cameras"
        return read, assumed
    for option, given in (("size", source.size), ("lens", source.lens)):
        if given is not None:
            refuse(option, "--intrinsics beside it", "none")
    images, reasons = zip(*map(_image, EYE_NAMES, cameras), strict=True)
    return ReadCameras(*images), reasons[0] | reasons[1]


def _image(eye: str, found: MjcfCamera | None) -> tuple[Camera, dict[str, str]]:
    """Camera without distortion, and reasons of assumptions by dotted key."""
    given = found or MjcfCamera(None, None, None, np.nan, "")
    size = given.size or _ASSUMED_SIZE_PX
    missing = f"not in the file: {size[0]} x {size[1]}"
    assumed = {} if given.size else dict.fromkeys(("width_px", "height_px"), missing)
    focal: float | FloatArray | None = given.focal
    if found is None:
        focal = size[0] / 2.0 / tan(radians(_ASSUMED_FOV_DEG) / 2.0)
        field = f"a field of view of {_ASSUMED_FOV_DEG:g} degrees horizontally"
        assumed["focal_px"] = f"not in the file: {field}"
    elif focal is None:
        focal = size[1] / 2.0 / tan(radians(given.fovy_deg) / 2.0)
    principal = (np.array(size) - 1.0) / 2.0 if given.principal is None else given.principal
    camera = Camera(size=size, matrix=camera_matrix(np.broadcast_to(focal, 2), principal))
    assumed["distortion"] = "not in the file: no distortion"
    return camera, {f"eyes.{eye}.{key}": why for key, why in assumed.items()}


def _of_motors(assumed: Mapping[str, str], moved: Sequence[EyeMotor]) -> dict[str, str]:
    """Assumption keys and reasons, moved from joints to the motors that drive them, if any."""
    found: dict[str, str] = {}
    for key, why in assumed.items():
        joint, _, field = key.removeprefix("joints.").rpartition(".")
        movers = [motor.name for motor in moved if joint in motor.joint_factors]
        for moved_key in [f"actuators.{name}.{field}" for name in movers] or [key]:
            found.setdefault(moved_key, why)
    for motor in moved:
        found |= {f"actuators.{motor.name}.{key}": why for key, why in motor.assumed.items()}
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
    robot, (left, right) = mechanism.name or "a robot", source.cameras
    way = f"from {source.base} to the cameras {left} and {right}"
    lines = [f"The head of {robot} in {Path(source.file).name}, {way}."]
    if chains.fixed_values:
        held = (f"{name} at {value:.6g}" for name, value in chains.fixed_values.items())
        lines.append(f"Held, in rad or m: {', '.join(held)}.")
    lines.append("What the file lacks is assumed: see [assumptions].")
    printable = ("".join(c if c.isprintable() else "?" for c in line) for line in lines)
    return "".join(f"# {line}\n" for line in printable)


def _ignored(mechanism: Mechanism, chains: HeadChains) -> list[str]:
    found = [
        f"{name} (ties {', '.join(joints)}: see --actuators)"
        for name, joints in mechanism.left_out
        if not chains.joints.keys().isdisjoint(joints)
    ]
    bodies = [name for name, joints in mechanism.left_out if not joints]
    if bodies:
        more = f" and {len(bodies) - 1} more" if len(bodies) > 1 else ""
        found.append(f"{bodies[0]}{more}, which may tie bodies")
    if others := len(mechanism.joints()) - len(chains.joints) - len(chains.fixed_values):
        found.append(f"{others} other joints")
    simulators = "cameras and plugins of simulators other than MuJoCo"
    return [*found, "shapes, masses, friction, efforts", simulators]


def _pose_fields(position_key: str, pose: FloatArray, name: str) -> dict[str, Any]:
    """Fields of a pose: its position and, unless it is the identity, its rotation."""
    # restore values that only rounding has moved from 0 or 1
    near = np.round(pose)
    clean = np.where(np.abs(pose - near) < 1e-15, near, pose) + 0.0
    place, rotation = clean[:3, 3], clean[:3, :3]
    if not all(LENGTH[0](float(length)) for length in place):
        why = "name a --base nearer to the head (or is the file in millimetres?)"
        far = f"{np.linalg.norm(place):.3g} m: {why}"
        refuse(name, "to be less than 3 m from what carries it", far)
    turned = {"rotation": rotation.tolist()} if (rotation != np.eye(3)).any() else {}
    return {position_key: place.tolist(), **turned}


def _joint_fields(name: str, joint: ChainJoint) -> dict[str, Any]:
    """Fields of a joint's table in `[[joints]]`, without its limits."""
    origin = _pose_fields("origin_m", joint.origin, f"joint {name}")
    return {"name": name, "part": joint.part, **origin, "axis": (joint.joint.axis + 0.0).tolist()}


def _actuator_fields(motors: Sequence[EyeMotor]) -> dict[str, Any]:
    """Tables of actuators; empty if each joint has its own."""
    tables = [
        {"name": motor.name, "joints": dict(motor.joint_factors), **motor.limits.fields()}
        for motor in motors
    ]
    offsets = {joint: offset for motor in motors for joint, offset in motor.joint_offsets.items()}
    fields = {"actuators": tables, "joint_offsets_rad": offsets}
    return {key: value for key, value in fields.items() if value}
