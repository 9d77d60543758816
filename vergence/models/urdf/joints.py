"""Joints between a robot's base and its cameras: their roles, limits and motors."""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, NamedTuple, NoReturn

import numpy as np

from vergence.errors import ConfigurationError
from vergence.models.head_joints import ACCELERATION, RADIANS, SPEED, frame_between_cameras
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.models.toml_table import Rule
from vergence.models.urdf.mechanism import (
    Frame,
    Joint,
    Mechanism,
    MimicJoint,
    known_names_hint,
    number,
    refuse,
    refuse_unknown,
)

# Most joints that a head file has for the neck and for the chain of an eye (numerical).
_MAX_NECK_JOINTS: Final = 3
_MAX_EYE_JOINTS: Final = 2
UNREAL: Final = "no real limits (degrees?)"  # reason of limits that a file states wrongly
_HELD: Final = ("hinge", "slide")  # kinds that `--lock` can hold at a value


class ChainJoint(NamedTuple):
    """A moving joint."""

    joint: Joint
    part: str  # neck, both, left or right
    origin: FloatArray  # (4, 4) at its zero, in the previous joint's link, or the base
    axis_in_base: FloatArray  # (3,) with all joints at zero


class HeadChains:
    """Kinematic chains from the base to the left and the right camera, and each joint's role."""

    def __init__(
        self,
        mechanism: Mechanism,
        base: Frame,
        cameras: Sequence[Frame],
        neck: Sequence[str],
        lock: Sequence[str],
    ) -> None:
        self._mechanism, self._neck, self._known = mechanism, neck, mechanism.joints()
        self._locked = _parse_locked_joints(lock, self._known)
        above, below = base.lineage(), [camera.lineage() for camera in cameras]
        # up to the base from the common ancestor with a camera, and down to the camera
        self._paths = [
            ([f for f in above if f not in line], [f for f in line if f not in above])
            for line in below
        ]
        own = [_joints(down) for _, down in self._paths]
        self._shared = [joint.name for joint in own[0] if joint in own[1]]
        self._on_way = list(dict.fromkeys(j.name for way in self._paths for j in _joints(*way)))
        self.fixed_values: dict[str, float] = {}  # of the held ones on the way, rad or m
        self._check_options()
        self._check_frames((*above, *below[0], *below[1]))
        self._fix_joints()
        self._check_joints()
        parts = self._parts()
        # those that move: the neck's from the base up, both eyes', others
        self.joints: dict[str, ChainJoint] = {}
        chains = [self._chain(up, down, parts) for up, down in self._paths]
        self.joints = {name: self.joints[name] for name in parts}
        # (2, 4, 4) in the base, all joints at zero; and in the last joint's link, or the base
        self.camera_poses, self.mounts = map(np.stack, zip(*chains, strict=True))
        ties = map(mechanism.mimic_of, parts)
        self.mimic_joints = [tie for tie in ties if tie is not None]  # eye joints that follow one

    def eye_joints(self) -> dict[str, ChainJoint]:
        """Moving joints that are not of the neck."""
        return {name: each for name, each in self.joints.items() if each.part != "neck"}

    def _chain(
        self, up: Sequence[Frame], down: Sequence[Frame], parts: Mapping[str, str]
    ) -> tuple[FloatArray, FloatArray]:
        """(4, 4) camera in the base at zero, and in the last link; adds the moving joints."""
        at_zero, in_base = np.eye(4), self._mechanism.pose_along(up, self.fixed_values)
        pending = np.asarray(np.linalg.inv(in_base), dtype=np.float64)
        for frame in down:
            pending = pending @ frame.pose
            for joint in frame.joints:
                if joint.name in self.fixed_values:
                    pending = pending @ joint.motion(self.fixed_values[joint.name])
                    continue
                to_axis, turned, from_axis = np.eye(4), np.eye(4), np.eye(4)
                to_axis[:3, 3], from_axis[:3, 3] = joint.anchor, -joint.anchor
                turned[:3, :3] = joint.rotation(-joint.reference)
                origin = pending @ to_axis @ turned
                at_zero = at_zero @ origin
                axis, part = at_zero[:3, :3] @ joint.axis, parts[joint.name]
                self.joints.setdefault(joint.name, ChainJoint(joint, part, origin, axis))
                pending = from_axis
        return at_zero @ pending, pending

    def _check_options(self) -> None:
        """Refuse joints of `--neck` and `--lock` that are not there, or in a wrong place."""
        neck, shared = self._neck, self._shared
        for option, names in (("neck", neck), ("lock", self._locked)):
            for name in names:
                refuse_unknown(option, "joint", name, self._known)
                if name not in self._on_way:
                    there = ", ".join(self._on_way) or "there is none"
                    on_way = f"a joint on the way from the base to the cameras ({there})"
                    refuse(option, on_way, repr(name))
        if len(set(neck)) != len(neck):
            refuse("neck", "each joint once", " ".join(neck))
        for name in neck:
            if name in self._locked:
                refuse("lock", "joints that are not of the neck", repr(name))
            if name not in shared:
                there = f"({', '.join(shared) or 'there is none'})"
                one = f"{name!r}, which moves one of them"
                refuse("neck", f"joints that both cameras stand on {there}", one)
        if len(neck) > _MAX_NECK_JOINTS:
            options = self._neck_and_lock([name for name in shared if name in neck])
            got = f"{len(neck)} ({' '.join(neck)}): hold the others, such as {options}"
            refuse("neck", "up to three joints", got)

    def _neck_and_lock(self, names: Sequence[str]) -> str:
        """Options that make the uppermost joints the neck and lock the others."""
        neck, others = names[-_MAX_NECK_JOINTS:], names[:-_MAX_NECK_JOINTS]
        return f"--neck {' '.join(neck)}" + (f" {self._lock(others)}" if others else "")

    def _lock(self, names: Sequence[str]) -> str:
        """Option that locks joints as near to zero as their limits allow."""
        said = []
        for joint in map(self._known.__getitem__, names):
            value = float(np.nan_to_num(np.fmin(np.fmax(0.0, joint.lower), joint.upper)))
            shown = f"{value:.6g}m" if joint.kind == "slide" else f"{np.degrees(value):.6g}"
            said.append(f"{joint.name}={shown}")
        return f"--lock {' '.join(said)}"

    def _check_frames(self, lineages: Iterable[Frame]) -> None:
        """Refuse frames with a fault on the paths, and non-finite poses from the root on."""
        for up, down in self._paths:
            for frame in self._mechanism.frames:
                if frame.fault and frame in (*up, *down):
                    raise ConfigurationError(frame.fault)
        for frame in lineages:
            if not np.isfinite(frame.pose).all():
                refuse(f"frame {frame.name}", "a finite pose", frame.pose[:3, 3].tolist())

    def _check_joints(self) -> None:
        """Refuse joints that move the base, do not turn, or have no axis."""
        for up, down in self._paths:
            for joint in _joints(up):
                if joint.name not in self.fixed_values:
                    held = f", or --lock {joint.name}=DEG" if joint.kind in _HELD else ""
                    got = f"one that {joint.name} moves: name a base below it{held}"
                    refuse("base", "a frame that the neck stands on", got)
            for joint in _joints(down):
                if joint.name not in self.fixed_values and joint.kind != "hinge":
                    _refuse_kind(joint)
            for joint in _joints(up, down):
                if not np.isfinite([joint.axis, joint.anchor]).all():
                    refuse(f"joint {joint.name}", "an axis with a direction", "none")

    def _fix_joints(self) -> None:
        """Find the values of the locked joints and of the joints coupled to them."""
        for name in self._on_way:
            owner, mimic = f"joint {name}", self._mechanism.mimic_of(name)
            if name in self._locked:
                self._check_lock(self._known[name], mimic)
                self.fixed_values[name] = self._locked[name]
                continue
            if mimic is None:
                continue
            master, follows = mimic.master, f"one that follows {mimic.master}"
            if np.isnan(mimic.multiplier):
                straight = "one that follows one other joint by a straight line, which is all that"
                refuse(owner, f"{straight} a head file can say", f"{follows} otherwise")
            elif mimic.multiplier == 0.0:
                self.fixed_values[name] = mimic.offset
            elif master in self._locked:
                self.fixed_values[name] = mimic.follow(self._locked)
            elif master not in self._known:
                hint = known_names_hint("moving joint", master, self._known)
                none = f"one that follows {master!r}, which is none"
                refuse(owner, f"one that follows {hint}", none)
            elif master not in self._on_way:
                aside = f"{follows}, which is not on the way to the cameras: --lock {name}=DEG"
                refuse(owner, "one that follows no joint or one of an eye", aside)
            elif name in self._neck or master in self._neck:
                neck = "which a head file cannot say of a neck"
                tied = f"{follows}, {neck}: lock both, or one motor could not move the two"
                refuse(owner, "a joint of the neck that moves by itself", tied)

    def _check_lock(self, joint: Joint, mimic: MimicJoint | None) -> None:
        value, lower, upper = self._locked[joint.name], joint.lower, joint.upper
        if joint.kind not in _HELD:
            _refuse_kind(joint)
        if mimic and mimic.master in self._on_way and mimic.master not in self._locked:
            got = f"{joint.name}, which follows {mimic.master}: lock that one"
            refuse("lock", "a joint that moves by itself", got)
        # tolerance for degrees given with few decimals
        if value < lower - 1e-3 or value > upper + 1e-3:
            unit, scale = ("m", 1.0) if joint.kind == "slide" else ("deg", 180.0 / np.pi)
            within = f"{joint.name} within {scale * lower:.6g} to {scale * upper:.6g} {unit}"
            refuse("lock", within, f"{scale * value:.6g}")

    def _parts(self) -> dict[str, str]:
        """Part of each moving joint (neck, both, left or right), from the base up."""
        neck, fixed = self._neck, self.fixed_values
        for name in neck:
            if name in fixed:
                refuse("neck", "joints that move", f"{name!r}, which is held by what it follows")
        moving = [name for name in self._shared if name not in fixed]
        own = {
            side: [j.name for j in _joints(down) if j.name not in (*self._shared, *fixed)]
            for side, (_, down) in zip(EYE_NAMES, self._paths, strict=True)
        }
        last = max((moving.index(name) for name in neck), default=-1)
        unnamed = [name for name in moving[: last + 1] if name not in neck]
        both = moving[last + 1 :]
        longest = max(map(len, own.values()))
        if unnamed or (both and len(both) + longest > _MAX_EYE_JOINTS):
            # the uppermost may turn both eyes, as long as no eye has more than two joints
            below = moving[: len(moving) - max(_MAX_EYE_JOINTS - longest, 0)]
            others = [name for name in below if name not in neck]
            way_on = self._lock(others) if neck else self._neck_and_lock(below)
            expected = (
                "every joint that both cameras stand on to be one of up to three of --neck, or "
                "held by --lock JOINT=DEG, or one of two that turn an eye"
            )
            refuse("neck", expected, f"{', '.join(unnamed or both)}: give {way_on}, say")
        for side, names in own.items():
            if len(names) > _MAX_EYE_JOINTS:
                more = [name for each in own.values() for name in each[_MAX_EYE_JOINTS:]]
                got = f"{len(names)} ({', '.join(names)}): give {self._lock(more)}, say"
                alone = "up to two joints that move this eye alone"
                refuse(f"{side} camera", f"{alone}, which is all that a head file can say", got)
        parts = dict.fromkeys(moving[: last + 1], "neck") | dict.fromkeys(both, "both")
        return parts | {name: side for side, names in own.items() for name in names}


def _joints(*paths: Sequence[Frame]) -> list[Joint]:
    return [joint for frames in paths for frame in frames for joint in frame.joints]


def _refuse_kind(joint: Joint) -> NoReturn:
    expected, way_on = "a joint that turns about one axis", "name a base above it"
    named = {"ball": "a ball joint", "free": "a floating joint"}
    found = named.get(joint.kind, f"type {joint.kind!r}")
    if joint.kind == "slide":
        expected, found = "a joint that turns", "one that slides (prismatic)"
        way_on = f"--lock {joint.name}=0.1m holds it in its place"
    refuse(f"joint {joint.name}", expected, f"{found}, which a head file cannot say: {way_on}")


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


Coupling = Literal["common-tilt", "version-vergence"]
"""Coupling of both eyes: one motor for both tilts, or motors for version and for vergence."""

_RANGE: Final = ("lower_rad", "upper_rad")
_NEAREST_FIXATION_M: Final = 0.25
"""Nearest point straight ahead that both eyes must be able to fixate (chosen: near objects
against the range of version)."""


class MotionLimits(NamedTuple):
    """Limits of a joint or a motor: rad, rad, rad/s, rad/s^2."""

    lower: float
    upper: float
    velocity: float
    acceleration: float

    def fields(self) -> dict[str, float]:
        """Fields of the limits of a joint or an actuator in a head file."""
        keys = (*_RANGE, "velocity_rad_s", "acceleration_rad_s2")
        return dict(zip(keys, map(float, self), strict=True))

    def of_master(self, factor: float, offset: float = 0.0) -> "MotionLimits":
        """Limits that a joint with these ones sets its master, `joint = factor master + offset`."""
        ends = [(end - offset) / factor for end in (self.lower, self.upper)]
        size = abs(factor)
        return MotionLimits(min(ends), max(ends), self.velocity / size, self.acceleration / size)

    def intersection(self, other: "MotionLimits") -> "MotionLimits":
        """Intersection of both limits."""
        least = map(min, self[1:], other[1:])
        return MotionLimits(max(self.lower, other.lower), *least)


@dataclass(frozen=True, kw_only=True)
class EyeMotor:
    """A motor and the eye joints that it moves: `joint = factor * motor + offset`."""

    name: str
    joint_factors: Mapping[str, float]
    joint_offsets: Mapping[str, float]  # rad, where not 0
    limits: MotionLimits
    assumed: Mapping[str, str]  # reason of an assumed limit by key of the head file


class _EyeJoint(NamedTuple):
    part: str  # both, left or right
    axis: FloatArray  # (3,) at zero, in the mean camera's axes: right, down, forward
    pans: bool  # turns its eye more left and right than up and down
    limits: MotionLimits


_EyeJoints = Mapping[str, _EyeJoint]


def find_eye_motors(
    chains: HeadChains,
    limits: Mapping[str, MotionLimits],
    couplings: Sequence[Coupling],
    poses: FloatArray,
) -> list[EyeMotor]:
    """Motors of the eyes, none if each joint has its own; `poses` (2, 4, 4) of the cameras."""
    ties = chains.mimic_joints
    if not ties and not couplings:
        return []
    R_base_between = frame_between_cameras(poses)[:3, :3]
    baseline_m = float(np.linalg.norm(poses[1, :3, 3] - poses[0, :3, 3]))
    joints = {}
    for name, each in chains.eye_joints().items():
        axis = each.axis_in_base @ R_base_between
        joints[name] = _EyeJoint(each.part, axis, bool(abs(axis[1]) > abs(axis[0])), limits[name])
    followers = [tie.joint for tie in ties]
    found = [_motor(name, ties, joints) for name in joints if name not in followers]
    for coupling in ("common-tilt", "version-vergence"):
        if coupling in couplings:
            pair = _pair(found, joints, coupling)
            if coupling == "common-tilt":
                new = [_common_tilt(*pair, joints)]
            else:
                new = _version_vergence(*pair, joints, baseline_m)
            place = min(i for i, motor in enumerate(found) if motor.name in pair)
            rest = [motor for motor in found if motor.name not in pair]
            found = [*rest[:place], *new, *rest[place:]]
    return found


def _motor(
    name: str, ties: Sequence[MimicJoint], joints: _EyeJoints, whose: tuple[str, str] | None = None
) -> EyeMotor:
    """Motor of an independent joint and of the joints tied to it."""
    mine = [tie for tie in ties if tie.master == name]
    limits = joints[name].limits
    for tie in mine:
        own = joints[tie.joint].limits
        limits = limits.intersection(own.of_master(tie.multiplier, tie.offset))
    if not limits.lower < limits.upper:
        followers = ", ".join(tie.joint for tie in mine)
        usual = (f"joint {name}", f"a range that it and what follows it ({followers})")
        owner, range_of = whose or usual
        refuse(owner, f"{range_of} have in common", "none")
    return EyeMotor(
        name=name,
        joint_factors={name: 1.0} | {tie.joint: tie.multiplier for tie in mine},
        joint_offsets={tie.joint: tie.offset for tie in mine if tie.offset},
        limits=limits,
        assumed={},
    )


def _pair(found: Sequence[EyeMotor], joints: _EyeJoints, coupling: str) -> tuple[str, str]:
    """Names of the left and the right joint that a coupling joins."""
    pans = coupling == "version-vergence"
    free = [motor.name for motor in found if len(motor.joint_factors) == 1]
    left, right = (
        [name for name in free if (joints[name].part, joints[name].pans) == (part, pans)]
        for part in EYE_NAMES
    )
    if len(left) == len(right) == 1:
        return left[0], right[0]
    turns = "pans" if pans else "tilts"
    alone = f"a joint that {turns} the left eye alone and one that {turns} the right"
    there = [f"{n} ({j.part}, {'pan' if j.pans else 'tilt'})" for n, j in joints.items()]
    expected = f"for {coupling} {alone}, neither tied to another"
    refuse("actuators", expected, ", ".join(there) or "none")


def _common_tilt(left: str, right: str, joints: _EyeJoints) -> EyeMotor:
    factor = 1.0 if joints[left].axis @ joints[right].axis > 0.0 else -1.0
    whose = ("actuators", f"for common-tilt a range that {left} and {right}")
    motor = _motor(left, [MimicJoint(right, left, factor, 0.0)], joints, whose)
    why = "what both tilts may do; --actuators common-tilt ties them"
    return replace(motor, name=_free_name("tilt", joints), assumed=dict.fromkeys(_RANGE, why))


def _version_vergence(
    left: str, right: str, joints: _EyeJoints, baseline_m: float
) -> list[EyeMotor]:
    """Motors of version and vergence (eyes: `version +- vergence / 2`) with the largest ranges."""
    pair = (left, right)
    signs = [float(np.sign(joints[name].axis[1])) for name in pair]
    # ranges of the left and right eye's rotation to the right
    l, r = (joints[n].limits.of_master(s) for n, s in zip(pair, signs, strict=True))  # noqa: E741
    # vergence that remains at both ends of the version range
    inward = 2.0 * min(l.upper - min(l.upper, r.upper), max(l.lower, r.lower) - r.lower)
    near = 2.0 * np.arctan(baseline_m / 2.0 / _NEAREST_FIXATION_M)
    vergence = float(max(inward, near))
    low, high = max(l.lower, r.lower + vergence / 2.0), min(l.upper - vergence / 2.0, r.upper)
    if not low < high:
        expected = f"for version-vergence pans that can converge on {_NEAREST_FIXATION_M} m"
        refuse("actuators", expected, f"{left} and {right} with too little range")
    _, _, velocity, acceleration = l.intersection(r)
    why = (
        "the largest ranges within those of both pans, chosen so that version and vergence at "
        "full speed together keep to the pans' limits"
    )
    half = [0.5 * signs[0], -0.5 * signs[1]]
    version = MotionLimits(low, high, velocity / 2.0, acceleration / 2.0)
    verging = MotionLimits(0.0, vergence, velocity, acceleration)
    return [
        EyeMotor(
            name=_free_name(name, joints),
            joint_factors=dict(zip(pair, factors, strict=True)),
            joint_offsets={},
            limits=limits,
            assumed=dict.fromkeys((*_RANGE, "velocity_rad_s"), why),
        )
        for name, factors, limits in (("version", signs, version), ("vergence", half, verging))
    ]


def _free_name(name: str, taken: _EyeJoints) -> str:
    while name in taken:
        name += "_motor"
    return name


_ASSUMED_ACCELERATION: Final = 40.0
"""Acceleration limit where none is given, rad/s^2 (chosen: common position servos reach it with
the weight of a small camera)."""
_PLACEHOLDER_RAD_S: Final = 40.0
"""Speed limit of a file from which on it is a placeholder, such as 99 or 100, rad/s (chosen: a
saccade reaches 16, the fastest robot eyes known to us some 35)."""


def joint_motion_limits(
    chains: HeadChains, speed: Sequence[str], acceleration: Sequence[str]
) -> tuple[dict[str, MotionLimits], dict[str, dict[str, str]]]:
    """Limits by moving joint, and the reason for each assumed one by joint and key."""
    joints = [moving.joint for moving in chains.joints.values()]
    speeds = _parse_per_joint("speed", speed, chains.joints, SPEED)
    accelerations = _parse_per_joint("acceleration", acceleration, chains.joints, ACCELERATION)
    unreal = {j.name: j.velocity for j in joints if not 0.0 < j.velocity < _PLACEHOLDER_RAD_S}
    lacking = [name for name in unreal if name not in speeds]
    if lacking and "" not in speeds:
        said = (f"{n} ({'none' if np.isnan(unreal[n]) else f'{unreal[n]:g}'})" for n in lacking)
        ways = f"--speed RAD_S (for all of these) or --speed {lacking[0]}=RAD_S"
        expected = f"speed limits of 0 to {_PLACEHOLDER_RAD_S:g} rad/s"
        refuse("speed", expected, f"{', '.join(said)}: give real ones by {ways}")
    ranges: dict[str, MotionLimits] = {}
    assumed: dict[str, dict[str, str]] = {}
    for joint in joints:
        name, velocity = joint.name, joint.velocity
        lower, upper, why = _angles(joint)
        reasons = assumed[name] = dict.fromkeys(_RANGE, why) if why else {}
        given = accelerations.get(name, accelerations.get("", _ASSUMED_ACCELERATION))
        if accelerations.keys().isdisjoint((name, "")):
            why = "not in the file, which has no place for it: that of common servos"
            reasons["acceleration_rad_s2"] = why
        if name in speeds or name in unreal:
            former = f" in place of {velocity:g} rad/s in the file"
            why = "; not in the file" if np.isnan(velocity) else former
            reasons["velocity_rad_s"] = f"given by --speed{why}"
            velocity = speeds[name if name in speeds else ""]
        ranges[name] = MotionLimits(lower, upper, velocity, given)
    return ranges, assumed


def _parse_per_joint(
    option: str, texts: Sequence[str], joints: Collection[str], rule: Rule
) -> dict[str, float]:
    """Numbers by joint from `JOINT=NUMBER`, and by the empty name from `NUMBER`."""
    found: dict[str, float] = {}
    for word in texts:
        name, equals, text = word.rpartition("=")
        value = number(text)
        if not rule[0](value):
            refuse(option, rule[1], repr(word))
        if equals:
            refuse_unknown(option, "moving joint", name, joints)
        if name in found:
            refuse(option, "one number a joint", f"{word!r} too")
        found[name] = value
    return found


def _angles(joint: Joint) -> tuple[float, float, str]:
    """Lower and upper limit, rad, and why they are assumed, or an empty text."""
    lower, upper = joint.lower, joint.upper
    if np.isnan(lower) or np.isnan(upper):
        return -np.pi, np.pi, "no limits in the file: one turn"
    got = f"{lower:g} to {upper:g} rad in the file"
    if not (RADIANS[0](lower) and RADIANS[0](upper)):
        return -np.pi, np.pi, f"{got}, {UNREAL}: one turn"
    if not lower < upper:
        held = f" for both: hold it by --lock {joint.name}={np.rad2deg(lower):.6g}"
        wrong = held if lower == upper else f" and {upper:g} rad"
        refuse(f"joint {joint.name}", "lower below upper", f"{lower:g}{wrong}")
    return lower, upper, ""
