"""A head from a robot's URDF or MJCF."""

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations, product
from math import radians, tan
from pathlib import Path
from typing import Any, Final

import numpy as np

from vergence.errors import HeadFileError
from vergence.models.camera import Camera, camera_matrix
from vergence.models.head import HeadModel
from vergence.models.head_file import (
    NAME,
    ROBOT,
    ROBOT_REASONS,
    camera_fields,
    check_head_name,
    eye_tables,
    head_of_document,
)
from vergence.models.head_joints import LENGTH
from vergence.models.mujoco import mujoco
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.models.stereo_files import ReadCameras, read_intrinsics
from vergence.models.toml_table import toml_text
from vergence.models.urdf.joints import (
    UNREAL,
    Coupling,
    EyeMotor,
    HeadChains,
    find_eye_motors,
    joint_motion_limits,
)
from vergence.models.urdf.mechanism import Frame, Mechanism, read_mechanism, refuse


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
    guesses: Sequence[str]  # doubts about calibration and limits, one phrase each


def import_urdf(source: UrdfSource) -> ImportedHead:
    """Build a head from two cameras of a robot and the joints that move them.

    Locked joints become part of the fixed poses between moving joints. Frame N follows the head
    file's default rule: fixed to the link of the last neck joint, midway between the cameras with
    all joints at zero.
    """
    mechanism = read_mechanism(source.file)
    base = mechanism.find_frame(source.base, "base", ("body", "site", "camera"))
    frames = [
        mechanism.find_frame(name, f"{eye}-camera", ("camera", "site", "body"))
        for eye, name in zip(EYE_NAMES, source.cameras, strict=True)
    ]
    left, right = source.cameras
    if left == right or ("depth" in left.lower()) != ("depth" in right.lower()):
        why = "vergence needs two cameras, and a colour and a depth frame of one device are not two"
        refuse("left-camera, right-camera", "frames of two cameras", f"{left} and {right}: {why}")
    chains = HeadChains(mechanism, base, frames, source.neck, source.lock)
    axes = _axes(frames, source.camera_axes)
    poses = chains.camera_poses @ axes
    joints = [
        {
            "name": name,
            "part": moving.part,
            **_pose_fields("origin_m", moving.origin, f"joint {name}"),
            "axis": (moving.joint.axis + 0.0).tolist(),
        }
        for name, moving in chains.joints.items()
    ]
    mounts = [
        _pose_fields("position_m", mount, f"{eye} camera")
        for eye, mount in zip(EYE_NAMES, chains.mounts @ axes, strict=True)
    ]
    if not source.camera_axes:
        base_in_root = mechanism.pose_along(base.lineage(), chains.fixed_values)
        _check_camera_axes(source.cameras, poses, chains, up=base_in_root[2, :3])
    limits, assumed = joint_motion_limits(chains, source.speed, source.acceleration)
    unreal = [
        f"joint {joint}: {why}"
        for joint, reasons in assumed.items()
        for why in dict.fromkeys(reasons.values())
        if UNREAL in why
    ]
    motors = find_eye_motors(chains, limits, source.couplings, poses)
    read, unsaid = _images([frame.camera for frame in frames], source)
    if read.left.size == read.right.size:
        size = re.compile(r"eyes\.\w+\.(?=width_px|height_px)")
        unsaid = {size.sub("image.", key): reason for key, reason in unsaid.items()}
    fields = [camera_fields(image) | mount for image, mount in zip(read, mounts, strict=True)]
    tables = eye_tables(read, fields)
    eyes = tables.pop("eyes")
    actuators = [
        {"name": motor.name, "joints": dict(motor.joint_factors), **motor.limits.fields()}
        for motor in motors
    ]
    offsets = {joint: by for motor in motors for joint, by in motor.joint_offsets.items()}
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
        **({"actuators": actuators} if actuators else {}),
        **({"joint_offsets_rad": offsets} if offsets else {}),
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
        guesses=(*(read.guesses if source.intrinsics else ()), *unreal),
    )


_OPTICAL_AXES: Final = "x,y,z"  # axes of an optical frame: x right, y down, z forward
_MUJOCO_AXES: Final = "x,-y,-z"
"""Axes of MuJoCo's cameras, which look along -z with y up, as in OpenGL."""
_SIGNED: Final = {sign + name: s * np.eye(3)[i] for s, sign in ((1.0, ""), (-1.0, "-"))
                  for i, name in enumerate("xyz")}  # fmt: skip
_ROTATIONS: Final = {
    ",".join(triple): rotation
    for names in permutations("xyz")
    for signs in product(("", "-"), repeat=3)
    for triple in [[sign + name for sign, name in zip(signs, names, strict=True)]]
    for rotation in [np.column_stack([_SIGNED[axis] for axis in triple])]
    if np.linalg.det(rotation) > 0.0
}
"""(3, 3) R_frame_camera by axes `right,down,forward`."""

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
    other = ",".join([*names[:-1], f"-{names[-1]}".removeprefix("--")])
    expected = (
        "the axes of the camera's frame that point right in the image, down in it and forward, "
        "such as x,-y,-z"
    )
    if other in _ROTATIONS and names[-1] in _SIGNED:
        expected += ", forward being right x down"
        got += f", which is left-handed ({other} is not)"
    if axes not in _ROTATIONS:
        refuse("camera-axes", expected, got)
    return _ROTATIONS[axes]


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
    joint_axes = [
        np.reshape([j.axis_in_base for j in turning if j.part in ("both", side)], (-1, 3))
        for side in EYE_NAMES
    ]
    eyes = list(zip(poses[:, :3, :3], joint_axes, strict=True))
    faults = [_fault(*_cosines(*eye, across, up)) for eye in eyes]
    if not any(faults):
        return
    name, why = next(pair for pair in zip(names, faults, strict=True) if pair[1])
    weights = (-2.0, 0.0, 1.0, 1.5)  # of the cosines, in how badly axes fit (chosen)
    fitting = [
        min(
            _ROTATIONS, key=lambda axes: _cosines(R @ _ROTATIONS[axes], about, across, up) @ weights
        )
        for R, about in eyes
    ]
    swapped = all(R[:, 0] @ across < -_ALIGNED_COSINE for R, _ in eyes)
    exchanged = "; or the left and the right camera are exchanged" if swapped else ""
    got = f"one whose {why}:"
    if set(fitting) == {_OPTICAL_AXES}:
        way_on = f"check which frames are the cameras (--camera-axes={_OPTICAL_AXES} takes them as"
        way_on = f"{way_on} they are{exchanged})"
        refuse(name, "cameras side by side that look ahead at zero", f"{got} {way_on}")
    text = " ".join(f"--camera-axes={triple}" for triple in dict.fromkeys(fitting))
    way_on = f"{text} would fit ({_OPTICAL_AXES} if it is right as it is{exchanged})"
    refuse(name, "a camera frame with x right, y down and z forward", f"{got} {way_on}")


def _cosines(
    rotation: FloatArray, joint_axes: FloatArray, across: FloatArray, up: FloatArray
) -> FloatArray:
    """(4,) cosines: x and z along the line between the cameras, y upwards, z along a joint."""
    right, down, forward = rotation.T
    rolled = np.abs(joint_axes @ forward).max(initial=0.0)
    return np.array([right @ across, forward @ across, down @ up, rolled])


def _fault(right: float, forward: float, upwards: float, rolled: float) -> str:
    """Why a camera frame of these cosines is not optical; empty if it is."""
    x, z = (f"{np.rad2deg(np.arccos(np.clip(c, -1.0, 1.0))):.0f} degrees" for c in (right, forward))
    if right < _ALIGNED_COSINE:
        return f"x is {x} from the line from the left camera to the right one"
    if abs(forward) > _ALIGNED_COSINE:
        return f"z is {z} from the line between the cameras"
    if upwards > _ALIGNED_COSINE:
        return "y points up"
    return "z lies along an axis that the eye turns about" if rolled > _ROLL_AXIS_COSINE else ""


_ASSUMED_SIZE_PX: Final = (640, 480)
"""Image size of a camera without a given one, px (chosen: common with webcams)."""
_ASSUMED_FOV_DEG: Final = 60.0
"""Horizontal field of view of a camera without a given one, degrees (chosen)."""


def _images(cameras: Sequence[Any], source: UrdfSource) -> tuple[ReadCameras, dict[str, str]]:
    """Intrinsics of both eyes, files before cameras, and reasons of assumptions by dotted key."""
    for eye, camera in zip(EYE_NAMES, cameras, strict=True):
        if camera is None:
            continue
        got, expected = "", "a camera that is fixed to its body and sees in perspective"
        if camera.proj != mujoco.mjtProjection.mjPROJ_PERSPECTIVE:
            got = "one that has a projection that is not perspective"
        if camera.mode != mujoco.mjtCamLight.mjCAMLIGHT_FIXED:
            got = "one that turns by itself after something (its mode is not fixed)"
        if got:
            refuse(f"{eye}-camera", expected, got)
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


def _image(eye: str, camera: Any) -> tuple[Camera, dict[str, str]]:
    """Camera without distortion, and reasons of assumptions by dotted key."""
    assumed = {}
    # one pixel, MuJoCo's default, is no given resolution
    given = camera is not None and max(camera.resolution) > 1
    width, height = map(int, camera.resolution) if given else _ASSUMED_SIZE_PX
    if not given:
        missing = f"not in the file: {width} x {height}"
        assumed = dict.fromkeys(("width_px", "height_px"), missing)
    size = np.array([width, height], dtype=np.float64)
    focal: float | FloatArray | None = None
    principal = (size - 1.0) / 2.0
    if camera is None:
        focal = width / 2.0 / tan(radians(_ASSUMED_FOV_DEG) / 2.0)
        field = f"a field of view of {_ASSUMED_FOV_DEG:g} degrees horizontally"
        assumed["focal_px"] = f"not in the file: {field}"
    elif given and (sensor := _decimals(camera.sensor_size)).min() > 0.0:
        pixels, offset = _decimals(camera.focal_pixel), _decimals(camera.principal_pixel)
        if not pixels.any():
            pixels = _decimals(camera.focal_length) / sensor * size
        if not offset.any():
            offset = _decimals(camera.principal_length) / sensor * size
        if pixels.min() > 0.0:
            # the offset points from the image centre left and up; pixel edges are at integers
            focal, principal = pixels, size / 2.0 - offset - 0.5
    if focal is None:
        focal = height / 2.0 / tan(radians(camera.fovy) / 2.0)
    matrix = camera_matrix(np.broadcast_to(focal, 2), principal)
    assumed["distortion"] = "not in the file: no distortion"
    reasons = {f"eyes.{eye}.{key}": why for key, why in assumed.items()}
    return Camera(size=(width, height), matrix=matrix), reasons


def _decimals(values: Any) -> FloatArray:
    """Numbers as written in the file, from MuJoCo's single-precision values."""
    return np.array(values, np.float32).astype(str).astype(np.float64)


def _of_motors(
    assumed: Mapping[str, Mapping[str, str]], motors: Sequence[EyeMotor]
) -> dict[str, str]:
    """Reasons by dotted key, moved from joints to the motors that drive them, if any."""
    found: dict[str, str] = {}
    for joint, reasons in assumed.items():
        movers = [f"actuators.{motor.name}" for motor in motors if joint in motor.joint_factors]
        for key, why in reasons.items():
            for table in movers or [f"joints.{joint}"]:
                found.setdefault(f"{table}.{key}", why)
    for motor in motors:
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
