"""The chains of joints from a robot's base to its two cameras."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from vergence.errors import ConfigurationError
from vergence.models.parts import FloatArray
from vergence.models.urdf.mechanism import (
    Joint,
    Mechanism,
    MimicJoint,
    known_names_hint,
)

# Most joints that a head file has for the neck and for the chain of an eye (numerical).
MAX_NECK_JOINTS: Final = 3
MAX_EYE_JOINTS: Final = 2
_SIDES: Final = ("left", "right")


@dataclass(frozen=True, eq=False)
class ChainJoint:
    """A moving joint."""

    joint: Joint
    origin: FloatArray  # (4, 4) at its zero, in the previous joint's link, or the base


@dataclass(frozen=True, eq=False)
class KinematicChain:
    """The moving joints from the base to a camera frame."""

    joints: tuple[ChainJoint, ...]  # from the base up
    camera_in_last_link: FloatArray  # (4, 4) in the last joint's link, or the base

    def pose(self, values: Mapping[str, float]) -> FloatArray:
        """T_base_frame, (4, 4), of the camera frame, at joint angles by name, rad."""
        pose = np.eye(4)
        for each in self.joints:
            turn = np.eye(4)
            turn[:3, :3] = each.joint.rotation(values[each.joint.name])
            pose = pose @ each.origin @ turn
        return np.asarray(pose @ self.camera_in_last_link)

    def axes(self, names: Sequence[str]) -> FloatArray:
        """(J, 3) axes of the named joints in the base's frame, at zero."""
        pose: FloatArray = np.eye(3)
        found: FloatArray = np.empty((0, 3))
        for each in self.joints:
            pose = pose @ each.origin[:3, :3]
            if each.joint.name in names:
                found = np.vstack([found, pose @ each.joint.axis])
        return found


@dataclass(frozen=True)
class JointPath:
    """Joints on the path from a base to a camera: up to the common ancestor, then down."""

    up: tuple[Joint, ...]
    down: tuple[Joint, ...]


def find_joint_path(mechanism: Mechanism, base: int, camera: int) -> JointPath:
    """Find the joints on the path from a base to a camera."""
    above, below = mechanism.ancestors(base), mechanism.ancestors(camera)
    frames = mechanism.frames
    return JointPath(
        up=tuple(j for i in above if i not in below for j in frames[i].joints),
        down=tuple(j for i in below if i not in above for j in frames[i].joints),
    )


def build_chain(
    mechanism: Mechanism, base: int, camera: int, fixed_values: Mapping[str, float]
) -> KinematicChain:
    """Build the chain of hinges from a base to a camera; fixed values in rad or m, by name."""
    above, below = mechanism.ancestors(base), mechanism.ancestors(camera)
    pending = np.linalg.inv(_still(mechanism, [i for i in above if i not in below], fixed_values))
    joints = []
    for index in (i for i in below if i not in above):
        frame = mechanism.frames[index]
        pending = pending @ frame.pose
        for joint in frame.joints:
            if joint.name in fixed_values:
                pending = pending @ joint.motion(fixed_values[joint.name])
                continue
            to_axis = np.eye(4)
            to_axis[:3, 3] = joint.anchor
            turned = np.eye(4)
            turned[:3, :3] = joint.rotation(-joint.reference)
            joints.append(ChainJoint(joint, pending @ to_axis @ turned))
            pending = np.linalg.inv(to_axis)
    return KinematicChain(tuple(joints), np.asarray(pending, dtype=np.float64))


def _still(mechanism: Mechanism, frames: Sequence[int], fixed: Mapping[str, float]) -> FloatArray:
    pose = np.eye(4)
    for index in frames:
        pose = pose @ mechanism.frames[index].pose
        for joint in mechanism.frames[index].joints:
            pose = pose @ joint.motion(fixed[joint.name])
    return pose


@dataclass(frozen=True, kw_only=True, eq=False)
class HeadChains:
    """Kinematic chains of both eyes, and the role of each joint."""

    chains: tuple[KinematicChain, KinematicChain]  # left, right
    moved_part_of_joint: Mapping[str, str]  # neck, both, left or right; from the base up
    mimic_joints: tuple[MimicJoint, ...]  # eye joints coupled to another
    fixed_values: Mapping[str, float]  # on the path, by name, rad or m

    def joint(self, name: str) -> ChainJoint:
        """Return a moving joint by name."""
        return next(j for chain in self.chains for j in chain.joints if j.joint.name == name)

    def axis(self, name: str) -> FloatArray:
        """(3,) axis of a moving joint in the base's frame, at zero."""
        return np.asarray(np.concatenate([chain.axes([name]) for chain in self.chains])[0])


def build_head_chains(
    mechanism: Mechanism,
    *,
    base: int,
    cameras: tuple[int, int],
    neck: Sequence[str],
    locked: Mapping[str, float],
) -> HeadChains:
    """Determine the role of each joint between the base and the cameras."""
    paths = tuple(find_joint_path(mechanism, base, camera) for camera in cameras)
    on_way = list(dict.fromkeys(j.name for way in paths for j in (*way.up, *way.down)))
    shared = [j.name for j in paths[0].down if j.name in {k.name for k in paths[1].down}]
    _check_neck(mechanism, neck, on_way, shared, locked, paths)
    _check_frames(mechanism, base, cameras)
    fixed = _stand_still(mechanism, on_way, neck, locked)
    for way in paths:
        for joint in way.up:
            if joint.name not in fixed:
                held = f", or --lock {joint.name}=DEG" if joint.kind in ("hinge", "slide") else ""
                raise ConfigurationError(
                    f"base: expected a frame that the neck stands on, got one that {joint.name} "
                    f"moves: name a base below it{held}"
                )
        for joint in way.down:
            if joint.name not in fixed and joint.kind != "hinge":
                raise ConfigurationError(_why_not(joint))
        for joint in (*way.up, *way.down):
            if not (np.isfinite(joint.axis).all() and np.isfinite(joint.anchor).all()):
                raise ConfigurationError(
                    f"joint {joint.name}: expected an axis with a direction, got none"
                )
    parts = _parts(paths, shared, neck, fixed)
    return HeadChains(
        chains=tuple(build_chain(mechanism, base, camera, fixed) for camera in cameras),  # type: ignore[arg-type]
        moved_part_of_joint=parts,
        mimic_joints=_eye_mimic_joints(mechanism, parts),
        fixed_values=fixed,
    )


def _check_frames(mechanism: Mechanism, base: int, cameras: tuple[int, int]) -> None:
    """Refuse frames with a fault on the path, and non-finite poses from the root to its ends."""
    above = mechanism.ancestors(base)
    for camera in cameras:
        for index in sorted({*above} ^ {*mechanism.ancestors(camera)}):
            if mechanism.frames[index].fault:
                raise ConfigurationError(mechanism.frames[index].fault)
    for end in (base, *cameras):
        for index in mechanism.ancestors(end):
            frame = mechanism.frames[index]
            if not np.isfinite(frame.pose).all():
                raise ConfigurationError(
                    f"frame {frame.name}: expected a finite pose, got {frame.pose[:3, 3].tolist()}"
                )


def _check_neck(
    mechanism: Mechanism,
    neck: Sequence[str],
    on_way: Sequence[str],
    shared: Sequence[str],
    locked: Mapping[str, float],
    paths: Sequence[JointPath],
) -> None:
    known = mechanism.joints()
    for option, names in (("neck", neck), ("lock", locked)):
        for name in names:
            if name not in known:
                raise ConfigurationError(
                    f"{option}: expected {known_names_hint('joint', name, known)}, got {name!r}"
                )
            if name not in on_way:
                raise ConfigurationError(
                    f"{option}: expected a joint on the way from the base to the cameras "
                    f"({', '.join(on_way) or 'there is none'}), got {name!r}"
                )
    if len(set(neck)) != len(neck):
        raise ConfigurationError(f"neck: expected each joint once, got {' '.join(neck)}")
    for name in neck:
        if name in locked:
            raise ConfigurationError(
                f"lock: expected joints that are not of the neck, got {name!r}"
            )
        if name not in shared:
            raise ConfigurationError(
                f"neck: expected joints that both cameras stand on "
                f"({', '.join(shared) or 'there is none'}), got {name!r}, which moves one of them"
            )
    if len(neck) > MAX_NECK_JOINTS:
        named = [name for name in shared if name in neck]
        raise ConfigurationError(
            f"neck: expected up to three joints, got {len(neck)} ({' '.join(neck)}): hold the "
            f"others, such as {_three_and_held(paths, named)}"
        )


def _stand_still(
    mechanism: Mechanism,
    on_way: Sequence[str],
    neck: Sequence[str],
    locked: Mapping[str, float],
) -> dict[str, float]:
    """Values of the locked joints and of the joints coupled to them."""
    known = mechanism.joints()
    fixed = {}
    for name in on_way:
        mimic = mechanism.mimic_of(name)
        if name in locked:
            _check_lock(known[name], locked[name], mimic, on_way, locked)
            fixed[name] = locked[name]
        elif mimic is None:
            continue
        elif np.isnan(mimic.multiplier):
            raise ConfigurationError(
                f"joint {name}: expected one that follows one other joint by a straight line, "
                f"which is all that a head file can say, got one that follows {mimic.master} "
                "otherwise"
            )
        elif mimic.multiplier == 0.0:
            fixed[name] = mimic.offset
        elif mimic.master in locked:
            fixed[name] = mimic.multiplier * locked[mimic.master] + mimic.offset
        elif mimic.master not in known:
            raise ConfigurationError(
                f"joint {name}: expected one that follows "
                f"{known_names_hint('moving joint', mimic.master, known)}, got one that follows "
                f"{mimic.master!r}, which is none"
            )
        elif mimic.master not in on_way:
            raise ConfigurationError(
                f"joint {name}: expected one that follows no joint or one of an eye, got one that "
                f"follows {mimic.master}, which is not on the way to the cameras: --lock {name}=DEG"
            )
        elif name in neck or mimic.master in neck:
            raise ConfigurationError(
                f"joint {name}: expected a joint of the neck that moves by itself, got one that "
                f"follows {mimic.master}, which a head file cannot say of a neck: lock both, or "
                "one motor could not move the two"
            )
    return fixed


def _check_lock(
    joint: Joint,
    value: float,
    mimic: MimicJoint | None,
    on_way: Sequence[str],
    locked: Mapping[str, float],
) -> None:
    if joint.kind not in ("hinge", "slide"):
        raise ConfigurationError(_why_not(joint))
    if mimic is not None and mimic.master in on_way and mimic.master not in locked:
        raise ConfigurationError(
            f"lock: expected a joint that moves by itself, got {joint.name}, which follows "
            f"{mimic.master}: lock that one"
        )
    unit, scale = ("m", 1.0) if joint.kind == "slide" else ("deg", 180.0 / np.pi)
    # tolerance for degrees given with few decimals
    if value < joint.lower - 1e-3 or value > joint.upper + 1e-3:
        raise ConfigurationError(
            f"lock: expected {joint.name} within {scale * joint.lower:.6g} to "
            f"{scale * joint.upper:.6g} {unit}, got {scale * value:.6g}"
        )


def _why_not(joint: Joint) -> str:
    if joint.kind == "slide":
        return (
            f"joint {joint.name}: expected a joint that turns, got one that slides (prismatic), "
            f"which a head file cannot say: --lock {joint.name}=0.1m holds it in its place"
        )
    named = {"ball": "a ball joint", "free": "a floating joint"}
    name = named.get(joint.kind, f"type {joint.kind!r}")
    return (
        f"joint {joint.name}: expected a joint that turns about one axis, got {name}, which a head "
        "file cannot say: name a base above it"
    )


def _parts(
    paths: Sequence[JointPath],
    shared: Sequence[str],
    neck: Sequence[str],
    fixed: Mapping[str, float],
) -> dict[str, str]:
    for name in neck:
        if name in fixed:
            raise ConfigurationError(
                f"neck: expected joints that move, got {name!r}, which is held by what it follows"
            )
    moving = [name for name in shared if name not in fixed]
    own = {
        side: [j.name for j in way.down if j.name not in shared and j.name not in fixed]
        for side, way in zip(_SIDES, paths, strict=True)
    }
    last = max((moving.index(name) for name in neck), default=-1)
    unnamed = [name for name in moving[: last + 1] if name not in neck]
    both = moving[last + 1 :]
    longest = max(len(names) for names in own.values())
    if unnamed or (both and len(both) + longest > MAX_EYE_JOINTS):
        # the uppermost may turn both eyes, as long as no eye has more than two joints
        below = moving[: len(moving) - max(MAX_EYE_JOINTS - longest, 0)]
        others = [name for name in below if name not in neck]
        way_on = _held(paths, others) if neck else _three_and_held(paths, below)
        raise ConfigurationError(
            "neck: expected every joint that both cameras stand on to be one of up to three of "
            "--neck, or held by --lock JOINT=DEG, or one of two that turn an eye, got "
            f"{', '.join(unnamed or both)}: give {way_on}, say"
        )
    for side, names in own.items():
        if len(names) > MAX_EYE_JOINTS:
            more = [name for each in own.values() for name in each[MAX_EYE_JOINTS:]]
            raise ConfigurationError(
                f"{side} camera: expected up to two joints that move this eye alone, which is all "
                f"that a head file can say, got {len(names)} ({', '.join(names)}): give "
                f"{_held(paths, more)}, say"
            )
    parts = dict.fromkeys(moving[: last + 1], "neck") | dict.fromkeys(both, "both")
    return parts | {name: side for side, names in own.items() for name in names}


def _three_and_held(paths: Sequence[JointPath], names: Sequence[str]) -> str:
    """Options that make the uppermost joints the neck and lock the others."""
    neck, others = names[-MAX_NECK_JOINTS:], names[:-MAX_NECK_JOINTS]
    return f"--neck {' '.join(neck)}" + (f" {_held(paths, others)}" if others else "")


def _held(paths: Sequence[JointPath], names: Sequence[str]) -> str:
    """Option that locks joints as near to zero as their limits allow."""
    known = {joint.name: joint for way in paths for joint in way.down}
    said = []
    for name in names:
        joint = known[name]
        value = float(np.nan_to_num(np.fmin(np.fmax(0.0, joint.lower), joint.upper)))
        said.append(
            f"{name}={value:.6g}m" if joint.kind == "slide" else f"{name}={np.degrees(value):.6g}"
        )
    return f"--lock {' '.join(said)}"


def _eye_mimic_joints(mechanism: Mechanism, parts: Mapping[str, str]) -> tuple[MimicJoint, ...]:
    found = (mechanism.mimic_of(name) for name in parts)
    return tuple(mimic for mimic in found if mimic is not None)


_NUMBER: Final = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([a-z]*)\s*")
_RADIANS_PER_UNIT: Final = {"": np.pi / 180.0, "deg": np.pi / 180.0, "rad": 1.0}
"""Radians per unit of an angle."""
_METRES_PER_UNIT: Final = {"m": 1.0, "mm": 1e-3}
"""Metres per unit of a length."""


def parse_locked_joints(texts: Sequence[str], joints: Mapping[str, Joint]) -> dict[str, float]:
    """Parse values, rad or m, from `JOINT=DEG`, `JOINT=1.5rad`, `JOINT=0.1m`."""
    found: dict[str, float] = {}
    for word in texts:
        name, equals, text = word.rpartition("=")
        if not equals:
            raise ConfigurationError(f"lock: expected JOINT=DEG, got {word!r}")
        if name not in joints:
            raise ConfigurationError(
                f"lock: expected {known_names_hint('joint', name, joints)}, got {name!r}"
            )
        if name in found:
            raise ConfigurationError(f"lock: expected each joint once, got {name} twice")
        slides = joints[name].kind == "slide"
        units = _METRES_PER_UNIT if slides else _RADIANS_PER_UNIT
        parts = _NUMBER.fullmatch(text)
        if parts is None or parts[2] not in units:
            example = f"{name}=0.1m" if slides else f"{name}=10, in degrees"
            raise ConfigurationError(f"lock: expected a place such as {example}, got {word!r}")
        found[name] = float(parts[1]) * units[parts[2]]
    return found


@dataclass(frozen=True)
class ValueByJoint:
    """Numbers that the user gives for joints."""

    each: Mapping[str, float]  # by joint name
    others: float | None  # for all other joints; None if not given


def parse_per_joint(
    option: str,
    texts: Sequence[str],
    joints: Sequence[str],
    is_valid: Callable[[float], bool],
    expected: str,
) -> ValueByJoint:
    """Parse numbers from `NUMBER` and `JOINT=NUMBER`."""
    each: dict[str, float] = {}
    others: float | None = None
    for word in texts:
        name, equals, text = word.rpartition("=")
        try:
            number = float(text)
        except ValueError:
            number = np.nan
        if np.isnan(number) or not is_valid(number):
            raise ConfigurationError(f"{option}: expected {expected}, got {word!r}")
        if equals and name not in joints:
            raise ConfigurationError(
                f"{option}: expected {known_names_hint('moving joint', name, joints)}, got {name!r}"
            )
        if name in each or (not equals and others is not None):
            raise ConfigurationError(f"{option}: expected one number a joint, got {word!r} too")
        if equals:
            each[name] = number
        else:
            others = number
    return ValueByJoint(each, others)
