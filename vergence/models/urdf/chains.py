"""The chains of joints from a robot's base to its two cameras."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from vergence.errors import ConfigurationError
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.models.urdf.mechanism import Joint, Mechanism, MimicJoint, known_names_hint

# Most joints that a head file has for the neck and for the chain of an eye (numerical).
_MAX_NECK_JOINTS: Final = 3
_MAX_EYE_JOINTS: Final = 2


@dataclass(frozen=True, eq=False)
class ChainJoint:
    """A moving joint."""

    joint: Joint
    part: str  # neck, both, left or right
    origin: FloatArray  # (4, 4) at its zero, in the previous joint's link, or the base
    axis_in_base: FloatArray  # (3,) with all joints at zero


@dataclass(frozen=True, kw_only=True, eq=False)
class HeadChains:
    """Kinematic chains of both eyes, and the role of each joint."""

    joints: Mapping[str, ChainJoint]  # that move: the neck's from the base up, both eyes', others
    mimic_joints: Sequence[MimicJoint]  # eye joints coupled to another
    fixed_values: Mapping[str, float]  # on the path, by name, rad or m
    camera_poses: FloatArray  # (2, 4, 4) in the base, all joints at zero
    mounts: FloatArray  # (2, 4, 4) camera frames in the last joint's link, or the base

    def eye_joints(self) -> dict[str, ChainJoint]:
        """Moving joints that are not of the neck."""
        return {name: each for name, each in self.joints.items() if each.part != "neck"}


@dataclass(frozen=True)
class _Path:
    """Frames from the base up to the common ancestor with a camera, then down; their joints."""

    frames_up: Sequence[int]
    frames_down: Sequence[int]
    up: Sequence[Joint]
    down: Sequence[Joint]


@dataclass(frozen=True)
class _Selection:
    """Joints on the way to the cameras, and what the user says of them."""

    known: Mapping[str, Joint]  # all of the file
    on_way: Sequence[str]
    shared: Sequence[str]  # that both cameras stand on
    neck: Sequence[str]
    locked: Mapping[str, float]

    def neck_and_lock(self, names: Sequence[str]) -> str:
        """Options that make the uppermost joints the neck and lock the others."""
        neck, others = names[-_MAX_NECK_JOINTS:], names[:-_MAX_NECK_JOINTS]
        return f"--neck {' '.join(neck)}" + (f" {self.lock(others)}" if others else "")

    def lock(self, names: Sequence[str]) -> str:
        """Option that locks joints as near to zero as their limits allow."""
        said = []
        for name in names:
            joint = self.known[name]
            value = float(np.nan_to_num(np.fmin(np.fmax(0.0, joint.lower), joint.upper)))
            slides = joint.kind == "slide"
            said.append(f"{name}={value if slides else np.degrees(value):.6g}{'m' * slides}")
        return f"--lock {' '.join(said)}"


def build_head_chains(
    mechanism: Mechanism,
    *,
    base: int,
    cameras: Sequence[int],
    neck: Sequence[str],
    locked: Mapping[str, float],
) -> HeadChains:
    """Determine the role of each joint between the base and the left and the right camera."""
    paths = [_path(mechanism, base, camera) for camera in cameras]
    on_way = list(dict.fromkeys(j.name for path in paths for j in (*path.up, *path.down)))
    shared = [j.name for j in paths[0].down if j in paths[1].down]
    selection = _Selection(mechanism.joints(), on_way, shared, neck, locked)
    _check_options(selection)
    _check_frames(mechanism, base, cameras, paths)
    fixed = _fixed_values(mechanism, selection)
    for path in paths:
        _check_joints(path, fixed)
    parts = _parts(selection, paths, fixed)
    chains = [_chain(mechanism, path, parts, fixed) for path in paths]
    found = {joint.joint.name: joint for joints, _, _ in reversed(chains) for joint in joints}
    ties = [tie for name in parts if (tie := mechanism.mimic_of(name)) is not None]
    return HeadChains(
        joints={name: found[name] for name in parts},
        mimic_joints=ties,
        fixed_values=fixed,
        camera_poses=np.stack([pose for _, pose, _ in chains]),
        mounts=np.stack([mount for _, _, mount in chains]),
    )


def _path(mechanism: Mechanism, base: int, camera: int) -> _Path:
    above, below = mechanism.ancestors(base), mechanism.ancestors(camera)
    up, down = [i for i in above if i not in below], [i for i in below if i not in above]
    joints = [[j for i in way for j in mechanism.frames[i].joints] for way in (up, down)]
    return _Path(up, down, *joints)


def _chain(
    mechanism: Mechanism, path: _Path, parts: Mapping[str, str], fixed: Mapping[str, float]
) -> tuple[list[ChainJoint], FloatArray, FloatArray]:
    """Moving joints; (4, 4) the camera frame in the base at zero, and in the last link."""
    joints = []
    at_zero = np.eye(4)
    pending = np.asarray(np.linalg.inv(mechanism.pose_along(path.frames_up, fixed)), np.float64)
    for index in path.frames_down:
        frame = mechanism.frames[index]
        pending = pending @ frame.pose
        for joint in frame.joints:
            if joint.name in fixed:
                pending = pending @ joint.motion(fixed[joint.name])
                continue
            to_axis, turned, from_axis = np.eye(4), np.eye(4), np.eye(4)
            to_axis[:3, 3], from_axis[:3, 3] = joint.anchor, -joint.anchor
            turned[:3, :3] = joint.rotation(-joint.reference)
            origin = pending @ to_axis @ turned
            at_zero = at_zero @ origin
            axis = at_zero[:3, :3] @ joint.axis
            joints.append(ChainJoint(joint, parts[joint.name], origin, axis))
            pending = from_axis
    return joints, at_zero @ pending, pending


def _check_options(selection: _Selection) -> None:
    """Refuse joints of `--neck` and `--lock` that are not there, or in a wrong place."""
    neck, locked, shared = selection.neck, selection.locked, selection.shared
    for option, names in (("neck", neck), ("lock", locked)):
        for name in names:
            _check_known(option, name, selection.known)
            if name not in selection.on_way:
                raise ConfigurationError(
                    f"{option}: expected a joint on the way from the base to the cameras "
                    f"({', '.join(selection.on_way) or 'there is none'}), got {name!r}"
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
    if len(neck) > _MAX_NECK_JOINTS:
        options = selection.neck_and_lock([name for name in shared if name in neck])
        raise ConfigurationError(
            f"neck: expected up to three joints, got {len(neck)} ({' '.join(neck)}): hold the "
            f"others, such as {options}"
        )


def _check_known(option: str, name: str, joints: Mapping[str, Joint]) -> None:
    if name not in joints:
        hint = known_names_hint("joint", name, joints)
        raise ConfigurationError(f"{option}: expected {hint}, got {name!r}")


def _check_frames(
    mechanism: Mechanism, base: int, cameras: Sequence[int], paths: Sequence[_Path]
) -> None:
    """Refuse frames with a fault on the path, and non-finite poses from the root to its ends."""
    frames = mechanism.frames
    for path in paths:
        for index in sorted((*path.frames_up, *path.frames_down)):
            if frames[index].fault:
                raise ConfigurationError(frames[index].fault)
    for end in (base, *cameras):
        for frame in (frames[index] for index in mechanism.ancestors(end)):
            if not np.isfinite(frame.pose).all():
                place = frame.pose[:3, 3].tolist()
                raise ConfigurationError(f"frame {frame.name}: expected a finite pose, got {place}")


def _check_joints(path: _Path, fixed: Mapping[str, float]) -> None:
    """Refuse joints that move the base, do not turn, or have no axis."""
    for joint in path.up:
        if joint.name not in fixed:
            held = f", or --lock {joint.name}=DEG" if joint.kind in ("hinge", "slide") else ""
            raise ConfigurationError(
                f"base: expected a frame that the neck stands on, got one that {joint.name} "
                f"moves: name a base below it{held}"
            )
    for joint in path.down:
        if joint.name not in fixed and joint.kind != "hinge":
            raise ConfigurationError(_why_not(joint))
    for joint in (*path.up, *path.down):
        if not (np.isfinite(joint.axis).all() and np.isfinite(joint.anchor).all()):
            raise ConfigurationError(
                f"joint {joint.name}: expected an axis with a direction, got none"
            )


def _fixed_values(mechanism: Mechanism, selection: _Selection) -> dict[str, float]:
    """Values of the locked joints and of the joints coupled to them."""
    known, on_way, locked = selection.known, selection.on_way, selection.locked
    fixed = {}
    for name in on_way:
        mimic = mechanism.mimic_of(name)
        wrong = ""
        if name in locked:
            _check_lock(selection, known[name], mimic)
            fixed[name] = locked[name]
        elif mimic is None:
            continue
        elif np.isnan(mimic.multiplier):
            wrong = (
                "one that follows one other joint by a straight line, which is all that a head "
                f"file can say, got one that follows {mimic.master} otherwise"
            )
        elif mimic.multiplier == 0.0:
            fixed[name] = mimic.offset
        elif mimic.master in locked:
            fixed[name] = mimic.follow(locked)
        elif mimic.master not in known:
            wrong = (
                f"one that follows {known_names_hint('moving joint', mimic.master, known)}, got "
                f"one that follows {mimic.master!r}, which is none"
            )
        elif mimic.master not in on_way:
            wrong = (
                f"one that follows no joint or one of an eye, got one that follows {mimic.master}, "
                f"which is not on the way to the cameras: --lock {name}=DEG"
            )
        elif name in selection.neck or mimic.master in selection.neck:
            wrong = (
                f"a joint of the neck that moves by itself, got one that follows {mimic.master}, "
                "which a head file cannot say of a neck: lock both, or one motor could not move "
                "the two"
            )
        if wrong:
            raise ConfigurationError(f"joint {name}: expected {wrong}")
    return fixed


def _check_lock(selection: _Selection, joint: Joint, mimic: MimicJoint | None) -> None:
    value, locked = selection.locked[joint.name], selection.locked
    if joint.kind not in ("hinge", "slide"):
        raise ConfigurationError(_why_not(joint))
    if mimic is not None and mimic.master in selection.on_way and mimic.master not in locked:
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
    selection: _Selection, paths: Sequence[_Path], fixed: Mapping[str, float]
) -> dict[str, str]:
    """Part of each moving joint (neck, both, left or right), from the base up."""
    shared, neck = selection.shared, selection.neck
    for name in neck:
        if name in fixed:
            raise ConfigurationError(
                f"neck: expected joints that move, got {name!r}, which is held by what it follows"
            )
    moving = [name for name in shared if name not in fixed]
    own = {
        side: [j.name for j in path.down if j.name not in shared and j.name not in fixed]
        for side, path in zip(EYE_NAMES, paths, strict=True)
    }
    last = max((moving.index(name) for name in neck), default=-1)
    unnamed = [name for name in moving[: last + 1] if name not in neck]
    both = moving[last + 1 :]
    longest = max(len(names) for names in own.values())
    if unnamed or (both and len(both) + longest > _MAX_EYE_JOINTS):
        # the uppermost may turn both eyes, as long as no eye has more than two joints
        below = moving[: len(moving) - max(_MAX_EYE_JOINTS - longest, 0)]
        others = [name for name in below if name not in neck]
        way_on = selection.lock(others) if neck else selection.neck_and_lock(below)
        raise ConfigurationError(
            "neck: expected every joint that both cameras stand on to be one of up to three of "
            "--neck, or held by --lock JOINT=DEG, or one of two that turn an eye, got "
            f"{', '.join(unnamed or both)}: give {way_on}, say"
        )
    for side, names in own.items():
        if len(names) > _MAX_EYE_JOINTS:
            more = [name for each in own.values() for name in each[_MAX_EYE_JOINTS:]]
            raise ConfigurationError(
                f"{side} camera: expected up to two joints that move this eye alone, which is all "
                f"that a head file can say, got {len(names)} ({', '.join(names)}): give "
                f"{selection.lock(more)}, say"
            )
    parts = dict.fromkeys(moving[: last + 1], "neck") | dict.fromkeys(both, "both")
    return parts | {name: side for side, names in own.items() for name in names}


_NUMBER: Final = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([a-z]*)\s*")
_RADIANS_PER_UNIT: Final = {"": np.pi / 180.0, "deg": np.pi / 180.0, "rad": 1.0}
_METRES_PER_UNIT: Final = {"m": 1.0, "mm": 1e-3}


def parse_locked_joints(texts: Sequence[str], joints: Mapping[str, Joint]) -> dict[str, float]:
    """Parse values, rad or m, from `JOINT=DEG`, `JOINT=1.5rad`, `JOINT=0.1m`."""
    found: dict[str, float] = {}
    for word in texts:
        name, equals, text = word.rpartition("=")
        if not equals:
            raise ConfigurationError(f"lock: expected JOINT=DEG, got {word!r}")
        _check_known("lock", name, joints)
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
