"""Motors of the eyes' joints in a robot description, and the limits of its joints."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, NamedTuple

import numpy as np

from vergence.models.head_joints import ACCELERATION, RADIANS, SPEED, frame_between_cameras
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.models.toml_table import Rule
from vergence.models.urdf.chains import HeadChains
from vergence.models.urdf.mechanism import Joint, MimicJoint, number, refuse, refuse_unknown

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
    joints: Sequence[Joint], speed: Sequence[str], acceleration: Sequence[str]
) -> tuple[dict[str, MotionLimits], dict[str, str]]:
    """Limits by moving joint, and the reason for each assumed one by its dotted key."""
    names = [joint.name for joint in joints]
    speeds = _parse_per_joint("speed", speed, names, SPEED)
    accelerations = _parse_per_joint("acceleration", acceleration, names, ACCELERATION)
    unreal = {j.name: j.velocity for j in joints if not 0.0 < j.velocity < _PLACEHOLDER_RAD_S}
    lacking = [name for name in unreal if name not in speeds]
    if lacking and "" not in speeds:
        said = (f"{n} ({'none' if np.isnan(unreal[n]) else f'{unreal[n]:g}'})" for n in lacking)
        ways = f"--speed RAD_S (for all of these) or --speed {lacking[0]}=RAD_S"
        expected = f"speed limits of 0 to {_PLACEHOLDER_RAD_S:g} rad/s"
        refuse("speed", expected, f"{', '.join(said)}: give real ones by {ways}")
    ranges: dict[str, MotionLimits] = {}
    assumed: dict[str, str] = {}
    for joint in joints:
        name, velocity, key = joint.name, joint.velocity, f"joints.{joint.name}"
        lower, upper, why = _angles(joint)
        if why:
            assumed |= {f"{key}.{end}": why for end in _RANGE}
        given = accelerations.get(name, accelerations.get("", _ASSUMED_ACCELERATION))
        if accelerations.keys().isdisjoint((name, "")):
            why = "not in the file, which has no place for it: that of common servos"
            assumed[f"{key}.acceleration_rad_s2"] = why
        if name in speeds or name in unreal:
            former = f" in place of {velocity:g} rad/s in the file"
            why = "; not in the file" if np.isnan(velocity) else former
            assumed[f"{key}.velocity_rad_s"] = f"given by --speed{why}"
            velocity = speeds[name if name in speeds else ""]
        ranges[name] = MotionLimits(lower, upper, velocity, given)
    return ranges, assumed


def _parse_per_joint(
    option: str, texts: Sequence[str], joints: Sequence[str], rule: Rule
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
        return -np.pi, np.pi, f"{got}, no real limits (degrees?): one turn"
    if not lower < upper:
        held = f" for both: hold it by --lock {joint.name}={np.rad2deg(lower):.6g}"
        wrong = held if lower == upper else f" and {upper:g} rad"
        refuse(f"joint {joint.name}", "lower below upper", f"{lower:g}{wrong}")
    return lower, upper, ""
