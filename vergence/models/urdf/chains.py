"""The chains of joints from a robot's base to its two cameras."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, NoReturn

import numpy as np

from vergence.errors import ConfigurationError
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.models.urdf.mechanism import Joint, Mechanism, MimicJoint, refuse, refuse_unknown

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


class _Path(NamedTuple):
    """Frames from the base up to the common ancestor with a camera, then down; their joints."""

    frames_up: Sequence[int]
    frames_down: Sequence[int]
    up: Sequence[Joint]
    down: Sequence[Joint]


class _Way(NamedTuple):
    """What lies between the base and the cameras, and what the user says of it."""

    mechanism: Mechanism
    known: Mapping[str, Joint]  # all of the file
    paths: Sequence[_Path]  # to the left and the right camera
    on_way: Sequence[str]
    shared: Sequence[str]  # that both cameras stand on
    neck: Sequence[str]
    locked: Mapping[str, float]
    fixed: dict[str, float]  # values of those locked and of those coupled to them

    def neck_and_lock(self, names: Sequence[str]) -> str:
        """Options that make the uppermost joints the neck and lock the others."""
        neck, others = names[-_MAX_NECK_JOINTS:], names[:-_MAX_NECK_JOINTS]
        return f"--neck {' '.join(neck)}" + (f" {self.lock(others)}" if others else "")

    def lock(self, names: Sequence[str]) -> str:
        """Option that locks joints as near to zero as their limits allow."""
        said = []
        for joint in map(self.known.__getitem__, names):
            value = float(np.nan_to_num(np.fmin(np.fmax(0.0, joint.lower), joint.upper)))
            shown = f"{value:.6g}m" if joint.kind == "slide" else f"{np.degrees(value):.6g}"
            said.append(f"{joint.name}={shown}")
        return f"--lock {' '.join(said)}"


def build_head_chains(
    mechanism: Mechanism, ends: Sequence[int], neck: Sequence[str], lock: Sequence[str]
) -> HeadChains:
    """Determine each joint's role between the ends: the base, the left and the right camera."""
    known = mechanism.joints()
    locked = _parse_locked_joints(lock, known)
    paths = [_path(mechanism, ends[0], camera) for camera in ends[1:]]
    on_way = list(dict.fromkeys(j.name for path in paths for j in (*path.up, *path.down)))
    shared = [j.name for j in paths[0].down if j in paths[1].down]
    way = _Way(mechanism, known, paths, on_way, shared, neck, locked, {})
    _check_options(way)
    _check_frames(way, ends)
    _fix_joints(way)
    _check_joints(way)
    parts = _parts(way)
    joints: dict[str, ChainJoint] = {}
    at_zero, mounts = zip(*(_chain(way, path, parts, joints) for path in paths), strict=True)
    ties = [tie for name in parts if (tie := mechanism.mimic_of(name)) is not None]
    return HeadChains(
        joints={name: joints[name] for name in parts},
        mimic_joints=ties,
        fixed_values=way.fixed,
        camera_poses=np.stack(at_zero),
        mounts=np.stack(mounts),
    )


def _path(mechanism: Mechanism, base: int, camera: int) -> _Path:
    above, below = mechanism.ancestors(base), mechanism.ancestors(camera)
    up, down = [i for i in above if i not in below], [i for i in below if i not in above]
    joints = [[j for i in way for j in mechanism.frames[i].joints] for way in (up, down)]
    return _Path(up, down, *joints)


def _chain(
    way: _Way, path: _Path, parts: Mapping[str, str], joints: dict[str, ChainJoint]
) -> tuple[FloatArray, FloatArray]:
    """(4, 4) camera frame in the base at zero, and in the last link; adds the moving joints."""
    mechanism, at_zero = way.mechanism, np.eye(4)
    pending = np.asarray(np.linalg.inv(mechanism.pose_along(path.frames_up, way.fixed)), float)
    for frame in map(mechanism.frames.__getitem__, path.frames_down):
        pending = pending @ frame.pose
        for joint in frame.joints:
            if joint.name in way.fixed:
                pending = pending @ joint.motion(way.fixed[joint.name])
                continue
            to_axis, turned, from_axis = np.eye(4), np.eye(4), np.eye(4)
            to_axis[:3, 3], from_axis[:3, 3] = joint.anchor, -joint.anchor
            turned[:3, :3] = joint.rotation(-joint.reference)
            origin = pending @ to_axis @ turned
            at_zero = at_zero @ origin
            axis = at_zero[:3, :3] @ joint.axis
            joints.setdefault(joint.name, ChainJoint(joint, parts[joint.name], origin, axis))
            pending = from_axis
    return at_zero @ pending, pending


def _check_options(way: _Way) -> None:
    """Refuse joints of `--neck` and `--lock` that are not there, or in a wrong place."""
    neck, shared = way.neck, way.shared
    for option, names in (("neck", neck), ("lock", way.locked)):
        for name in names:
            refuse_unknown(option, "joint", name, way.known)
            if name not in way.on_way:
                there = ", ".join(way.on_way) or "there is none"
                on_way = f"a joint on the way from the base to the cameras ({there})"
                refuse(option, on_way, repr(name))
    if len(set(neck)) != len(neck):
        refuse("neck", "each joint once", " ".join(neck))
    for name in neck:
        if name in way.locked:
            refuse("lock", "joints that are not of the neck", repr(name))
        if name not in shared:
            there = f"({', '.join(shared) or 'there is none'})"
            one = f"{name!r}, which moves one of them"
            refuse("neck", f"joints that both cameras stand on {there}", one)
    if len(neck) > _MAX_NECK_JOINTS:
        options = way.neck_and_lock([name for name in shared if name in neck])
        got = f"{len(neck)} ({' '.join(neck)}): hold the others, such as {options}"
        refuse("neck", "up to three joints", got)


def _check_frames(way: _Way, ends: Sequence[int]) -> None:
    """Refuse frames with a fault on the path, and non-finite poses from the root to its ends."""
    frames = way.mechanism.frames
    for path in way.paths:
        for index in sorted((*path.frames_up, *path.frames_down)):
            if frames[index].fault:
                raise ConfigurationError(frames[index].fault)
    for frame in (frames[i] for end in ends for i in way.mechanism.ancestors(end)):
        if not np.isfinite(frame.pose).all():
            refuse(f"frame {frame.name}", "a finite pose", frame.pose[:3, 3].tolist())


def _check_joints(way: _Way) -> None:
    """Refuse joints that move the base, do not turn, or have no axis."""
    for path in way.paths:
        for joint in path.up:
            if joint.name not in way.fixed:
                held = f", or --lock {joint.name}=DEG" if joint.kind in ("hinge", "slide") else ""
                got = f"one that {joint.name} moves: name a base below it{held}"
                refuse("base", "a frame that the neck stands on", got)
        for joint in path.down:
            if joint.name not in way.fixed and joint.kind != "hinge":
                _refuse_kind(joint)
        for joint in (*path.up, *path.down):
            if not np.isfinite([joint.axis, joint.anchor]).all():
                refuse(f"joint {joint.name}", "an axis with a direction", "none")


def _fix_joints(way: _Way) -> None:
    """Find the values of the locked joints and of the joints coupled to them."""
    for name in way.on_way:
        owner, mimic = f"joint {name}", way.mechanism.mimic_of(name)
        if name in way.locked:
            _check_lock(way, way.known[name], mimic)
            way.fixed[name] = way.locked[name]
            continue
        if mimic is None:
            continue
        master, follows = mimic.master, f"one that follows {mimic.master}"
        if np.isnan(mimic.multiplier):
            straight = "one that follows one other joint by a straight line, which is all that a "
            refuse(owner, f"{straight}head file can say", f"{follows} otherwise")
        elif mimic.multiplier == 0.0:
            way.fixed[name] = mimic.offset
        elif master in way.locked:
            way.fixed[name] = mimic.follow(way.locked)
        elif master not in way.known:
            form = "one that follows {}"
            refuse_unknown(owner, "moving joint", master, way.known, form, ", which is none")
        elif master not in way.on_way:
            aside = f"{follows}, which is not on the way to the cameras: --lock {name}=DEG"
            refuse(owner, "one that follows no joint or one of an eye", aside)
        elif name in way.neck or master in way.neck:
            tied = "which a head file cannot say of a neck: lock both, or one motor could not move"
            refuse(owner, "a joint of the neck that moves by itself", f"{follows}, {tied} the two")


def _check_lock(way: _Way, joint: Joint, mimic: MimicJoint | None) -> None:
    value, lower, upper = way.locked[joint.name], joint.lower, joint.upper
    if joint.kind not in ("hinge", "slide"):
        _refuse_kind(joint)
    if mimic is not None and mimic.master in way.on_way and mimic.master not in way.locked:
        got = f"{joint.name}, which follows {mimic.master}: lock that one"
        refuse("lock", "a joint that moves by itself", got)
    # tolerance for degrees given with few decimals
    if value < lower - 1e-3 or value > upper + 1e-3:
        unit, scale = ("m", 1.0) if joint.kind == "slide" else ("deg", 180.0 / np.pi)
        within = f"{joint.name} within {scale * lower:.6g} to {scale * upper:.6g} {unit}"
        refuse("lock", within, f"{scale * value:.6g}")


def _refuse_kind(joint: Joint) -> NoReturn:
    expected, way_on = "a joint that turns about one axis", "name a base above it"
    named = {"ball": "a ball joint", "free": "a floating joint"}
    found = named.get(joint.kind, f"type {joint.kind!r}")
    if joint.kind == "slide":
        expected, found = "a joint that turns", "one that slides (prismatic)"
        way_on = f"--lock {joint.name}=0.1m holds it in its place"
    refuse(f"joint {joint.name}", expected, f"{found}, which a head file cannot say: {way_on}")


def _parts(way: _Way) -> dict[str, str]:
    """Part of each moving joint (neck, both, left or right), from the base up."""
    shared, neck, fixed = way.shared, way.neck, way.fixed
    for name in neck:
        if name in fixed:
            refuse("neck", "joints that move", f"{name!r}, which is held by what it follows")
    moving = [name for name in shared if name not in fixed]
    own = {
        side: [j.name for j in path.down if j.name not in shared and j.name not in fixed]
        for side, path in zip(EYE_NAMES, way.paths, strict=True)
    }
    last = max((moving.index(name) for name in neck), default=-1)
    unnamed = [name for name in moving[: last + 1] if name not in neck]
    both = moving[last + 1 :]
    longest = max(len(names) for names in own.values())
    if unnamed or (both and len(both) + longest > _MAX_EYE_JOINTS):
        # the uppermost may turn both eyes, as long as no eye has more than two joints
        below = moving[: len(moving) - max(_MAX_EYE_JOINTS - longest, 0)]
        others = [name for name in below if name not in neck]
        way_on = way.lock(others) if neck else way.neck_and_lock(below)
        held = "held by --lock JOINT=DEG, or one of two that turn an eye"
        expected = "every joint that both cameras stand on to be one of up to three of --neck"
        refuse(
            "neck", f"{expected}, or {held}", f"{', '.join(unnamed or both)}: give {way_on}, say"
        )
    for side, names in own.items():
        if len(names) > _MAX_EYE_JOINTS:
            more = [name for each in own.values() for name in each[_MAX_EYE_JOINTS:]]
            got = f"{len(names)} ({', '.join(names)}): give {way.lock(more)}, say"
            alone = "up to two joints that move this eye alone"
            refuse(f"{side} camera", f"{alone}, which is all that a head file can say", got)
    parts = dict.fromkeys(moving[: last + 1], "neck") | dict.fromkeys(both, "both")
    return parts | {name: side for side, names in own.items() for name in names}


_NUMBER: Final = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([a-z]*)\s*")
_RADIANS_PER_UNIT: Final = {"": np.pi / 180.0, "deg": np.pi / 180.0, "rad": 1.0}
_METRES_PER_UNIT: Final = {"m": 1.0, "mm": 1e-3}


def _parse_locked_joints(texts: Sequence[str], joints: Mapping[str, Joint]) -> dict[str, float]:
    """Parse values, rad or m, from `JOINT=DEG`, `JOINT=1.5rad`, `JOINT=0.1m`."""
    found: dict[str, float] = {}
    for word in texts:
        name, equals, text = word.rpartition("=")
        if not equals:
            refuse("lock", "JOINT=DEG", repr(word))
        refuse_unknown("lock", "joint", name, joints)
        if name in found:
            refuse("lock", "each joint once", f"{name} twice")
        slides = joints[name].kind == "slide"
        units = _METRES_PER_UNIT if slides else _RADIANS_PER_UNIT
        parts = _NUMBER.fullmatch(text)
        if parts is None or parts[2] not in units:
            example = f"{name}=0.1m" if slides else f"{name}=10, in degrees"
            refuse("lock", f"a place such as {example}", repr(word))
        found[name] = float(parts[1]) * units[parts[2]]
    return found
