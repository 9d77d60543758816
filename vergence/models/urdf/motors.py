"""Motors of the eyes' joints in a robot description, and the limits of its joints."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from vergence.errors import ConfigurationError
from vergence.models.head_joints import ACCELERATION, RADIANS, SPEED
from vergence.models.parts import FloatArray
from vergence.models.urdf.chains import ValueByJoint, parse_per_joint
from vergence.models.urdf.mechanism import Joint, MimicJoint

Coupling = Literal["common-tilt", "version-vergence"]
"""Coupling of both eyes: one motor for both tilts, or motors for version and for vergence."""

_NEAREST_FIXATION_M: Final = 0.25
"""Nearest point straight ahead that both eyes must be able to fixate (chosen: near objects
against the range of version)."""


@dataclass(frozen=True)
class MotionLimits:
    """Limits of a joint or a motor: rad, rad, rad/s, rad/s^2."""

    lower: float
    upper: float
    velocity: float
    acceleration: float

    def limits_of_master(self, mimic: MimicJoint) -> "MotionLimits":
        """Limits that a joint with these ones sets its master, `joint = m master + offset`."""
        ends = [(end - mimic.offset) / mimic.multiplier for end in (self.lower, self.upper)]
        size = abs(mimic.multiplier)
        return MotionLimits(min(ends), max(ends), self.velocity / size, self.acceleration / size)

    def intersection(self, other: "MotionLimits") -> "MotionLimits":
        """Intersection of both limits."""
        return MotionLimits(
            max(self.lower, other.lower),
            min(self.upper, other.upper),
            min(self.velocity, other.velocity),
            min(self.acceleration, other.acceleration),
        )


@dataclass(frozen=True, kw_only=True)
class EyeMotor:
    """A motor and the eye joints that it moves: `joint = factor * motor + offset`."""

    name: str
    joint_factors: Mapping[str, float]  # factor by joint name
    joint_offsets: Mapping[str, float]  # rad, by joint name, where not 0
    limits: MotionLimits
    assumption_reason: str = ""  # empty if no limit is assumed
    assumed_keys: Sequence[str] = ("lower_rad", "upper_rad")  # keys of the head file it is for


@dataclass(frozen=True, kw_only=True, eq=False)
class EyeJoint:
    """A joint of an eye."""

    name: str
    moved_eyes: str  # both, left or right
    axis: FloatArray  # (3,) at zero, in the mean camera's axes: right, down, forward
    limits: MotionLimits

    @property
    def pans(self) -> bool:
        """True if the joint turns its eye more left and right than up and down."""
        return abs(float(self.axis[1])) > abs(float(self.axis[0]))


def find_eye_motors(
    joints: Sequence[EyeJoint],
    mimic_joints: Sequence[MimicJoint],
    couplings: Sequence[Coupling],
    baseline_m: float,
) -> list[EyeMotor]:
    """Motors of the eyes, in the order of their first joints."""
    by_name = {joint.name: joint for joint in joints}
    found = [
        _free(joint, mimic_joints, by_name)
        for joint in joints
        if joint.name not in _followers(mimic_joints)
    ]
    if "common-tilt" in couplings:
        left, right = _pair(found, by_name, "common-tilt", pans=False)
        found = _exchange(found, [left, right], [_common_tilt(left, right, by_name)])
    if "version-vergence" in couplings:
        left, right = _pair(found, by_name, "version-vergence", pans=True)
        found = _exchange(found, [left, right], _version_vergence(left, right, by_name, baseline_m))
    return found


def _followers(mimic_joints: Sequence[MimicJoint]) -> set[str]:
    return {mimic.joint for mimic in mimic_joints}


def _free(
    joint: EyeJoint, mimic_joints: Sequence[MimicJoint], by_name: Mapping[str, EyeJoint]
) -> EyeMotor:
    """Motor of an independent joint and of the joints coupled to it."""
    mine = [mimic for mimic in mimic_joints if mimic.master == joint.name]
    allowed = joint.limits
    for mimic in mine:
        allowed = allowed.intersection(by_name[mimic.joint].limits.limits_of_master(mimic))
    if not allowed.lower < allowed.upper:
        raise ConfigurationError(
            f"joint {joint.name}: expected a range that it and what follows it "
            f"({', '.join(mimic.joint for mimic in mine)}) have in common, got none"
        )
    return EyeMotor(
        name=joint.name,
        joint_factors={joint.name: 1.0} | {mimic.joint: mimic.multiplier for mimic in mine},
        joint_offsets={mimic.joint: mimic.offset for mimic in mine if mimic.offset},
        limits=allowed,
    )


def _pair(
    found: Sequence[EyeMotor], by_name: Mapping[str, EyeJoint], coupling: Coupling, *, pans: bool
) -> tuple[EyeMotor, EyeMotor]:
    """Motors of the left and the right joint that a coupling joins."""
    which = "pans" if pans else "tilts"
    own = {
        part: [
            motor
            for motor in found
            if len(motor.joint_factors) == 1
            and by_name[motor.name].moved_eyes == part
            and by_name[motor.name].pans == pans
        ]
        for part in ("left", "right")
    }
    if any(len(own_motors) != 1 for own_motors in own.values()):
        there = [
            f"{j.name} ({j.moved_eyes}, {'pan' if j.pans else 'tilt'})" for j in by_name.values()
        ]
        raise ConfigurationError(
            f"actuators: expected for {coupling} a joint that {which} the left eye alone and one "
            f"that {which} the right, neither tied to another, got {', '.join(there) or 'none'}"
        )
    return own["left"][0], own["right"][0]


def _exchange(found: list[EyeMotor], former: list[EyeMotor], new: list[EyeMotor]) -> list[EyeMotor]:
    place = min(found.index(motor) for motor in former)
    rest = [motor for motor in found if motor not in former]
    return [*rest[:place], *new, *rest[place:]]


def _common_tilt(left: EyeMotor, right: EyeMotor, by_name: Mapping[str, EyeJoint]) -> EyeMotor:
    axes = by_name[left.name].axis, by_name[right.name].axis
    factor = 1.0 if axes[0] @ axes[1] > 0.0 else -1.0
    mimic = MimicJoint(right.name, left.name, factor, 0.0)
    allowed = left.limits.intersection(right.limits.limits_of_master(mimic))
    if not allowed.lower < allowed.upper:
        raise ConfigurationError(
            f"actuators: expected for common-tilt a range that {left.name} and {right.name} have "
            "in common, got none"
        )
    return EyeMotor(
        name=_free_name("tilt", by_name),
        joint_factors={left.name: 1.0, right.name: factor},
        joint_offsets={},
        limits=allowed,
        assumption_reason="what both tilts may do; --actuators common-tilt ties them",
    )


def _version_vergence(
    left: EyeMotor, right: EyeMotor, by_name: Mapping[str, EyeJoint], baseline_m: float
) -> list[EyeMotor]:
    """Motors of version and vergence (eyes: `version +- vergence / 2`) with the largest ranges."""
    signs = [float(np.sign(by_name[motor.name].axis[1])) for motor in (left, right)]
    turned = [
        m.limits.limits_of_master(MimicJoint("", "", s, 0.0))
        for m, s in zip((left, right), signs, strict=True)
    ]
    l, r = turned  # noqa: E741 ranges of the left and right eye's rotation to the right
    low, high = max(l.lower, r.lower), min(l.upper, r.upper)
    # vergence that remains at both ends of the version range
    inward = 2.0 * min(l.upper - high, low - r.lower)
    near = 2.0 * np.arctan(baseline_m / 2.0 / _NEAREST_FIXATION_M)
    vergence = max(inward, near)
    low, high = max(l.lower, r.lower + vergence / 2.0), min(l.upper - vergence / 2.0, r.upper)
    if not low < high:
        raise ConfigurationError(
            f"actuators: expected for version-vergence pans that can converge on "
            f"{_NEAREST_FIXATION_M} m, "
            f"got {left.name} and {right.name} with too little range"
        )
    both = l.intersection(r)
    reason = (
        "the largest ranges within those of both pans, chosen so that version and vergence at "
        "full speed together keep to the pans' limits"
    )
    half = {left.name: 0.5 * signs[0], right.name: -0.5 * signs[1]}
    version = EyeMotor(
        name=_free_name("version", by_name),
        joint_factors={left.name: signs[0], right.name: signs[1]},
        joint_offsets={},
        limits=replace(
            both,
            lower=low,
            upper=high,
            velocity=both.velocity / 2.0,
            acceleration=both.acceleration / 2.0,
        ),
        assumption_reason=reason,
        assumed_keys=("lower_rad", "upper_rad", "velocity_rad_s"),
    )
    return [
        version,
        EyeMotor(
            name=_free_name("vergence", by_name),
            joint_factors=half,
            joint_offsets={},
            limits=replace(both, lower=0.0, upper=float(vergence)),
            assumption_reason=reason,
            assumed_keys=("lower_rad", "upper_rad", "velocity_rad_s"),
        ),
    ]


def _free_name(name: str, taken: Mapping[str, EyeJoint]) -> str:
    while name in taken:
        name += "_motor"
    return name


ASSUMED_ACCELERATION: Final = 40.0
"""Acceleration limit where none is given, rad/s^2 (chosen: common position servos reach it with
the weight of a small camera)."""


def joint_motion_limits(
    joints: Sequence[Joint], speed: Sequence[str], acceleration: Sequence[str]
) -> tuple[dict[str, MotionLimits], dict[str, str]]:
    """Limits by moving joint, and the reason for each assumed one by its dotted key."""
    names = [joint.name for joint in joints]
    speeds = parse_per_joint("speed", speed, names, *SPEED)
    accelerations = parse_per_joint("acceleration", acceleration, names, *ACCELERATION)
    _refuse_without_speed(joints, speeds)
    ranges: dict[str, MotionLimits] = {}
    assumed: dict[str, str] = {}
    for joint in joints:
        key = f"joints.{joint.name}"
        lower, upper, why = _angles(joint)
        if why:
            assumed[f"{key}.lower_rad"] = assumed[f"{key}.upper_rad"] = why
        given = accelerations.each.get(joint.name, accelerations.others)
        if given is None:
            assumed[f"{key}.acceleration_rad_s2"] = (
                "not in the file, which has no place for it: that of common servos"
            )
        velocity, why = _velocity(joint, speeds)
        if why:
            assumed[f"{key}.velocity_rad_s"] = why
        ranges[joint.name] = MotionLimits(
            lower, upper, velocity, ASSUMED_ACCELERATION if given is None else given
        )
    return ranges, assumed


def _angles(joint: Joint) -> tuple[float, float, str]:
    lower, upper = joint.lower, joint.upper
    if np.isnan(lower) or np.isnan(upper):
        return -np.pi, np.pi, "no limits in the file: one turn"
    if not (RADIANS[0](lower) and RADIANS[0](upper)):
        return (
            -np.pi,
            np.pi,
            (f"{lower:g} to {upper:g} rad in the file, no real limits (degrees?): one turn"),
        )
    if lower == upper:
        raise ConfigurationError(
            f"joint {joint.name}: expected lower below upper, got {lower:g} for both: hold it by "
            f"--lock {joint.name}={np.rad2deg(lower):.6g}"
        )
    if lower > upper:
        raise ConfigurationError(
            f"joint {joint.name}: expected lower below upper, got {lower:g} and {upper:g} rad"
        )
    return lower, upper, ""


_PLACEHOLDER_RAD_S: Final = 40.0
"""Speed limit of a file from which on it is a placeholder, such as 99 or 100, rad/s (chosen: a
saccade reaches 16, the fastest robot eyes known to us some 35)."""


def _is_real(velocity: float) -> bool:
    return not np.isnan(velocity) and SPEED[0](velocity) and velocity < _PLACEHOLDER_RAD_S


def _velocity(joint: Joint, speeds: ValueByJoint) -> tuple[float, str]:
    if joint.name in speeds.each:
        return speeds.each[joint.name], _override(joint)
    if _is_real(joint.velocity):
        return joint.velocity, ""
    assert speeds.others is not None  # refused before otherwise
    return speeds.others, _override(joint)


def _override(joint: Joint) -> str:
    if np.isnan(joint.velocity):
        return "given by --speed; not in the file"
    return f"given by --speed in place of {joint.velocity:g} rad/s in the file"


def _refuse_without_speed(joints: Sequence[Joint], speeds: ValueByJoint) -> None:
    if speeds.others is not None:
        return
    lacking: Mapping[str, float] = {
        joint.name: joint.velocity
        for joint in joints
        if joint.name not in speeds.each and not _is_real(joint.velocity)
    }
    if lacking:
        said = ", ".join(
            f"{name} ({'none' if np.isnan(value) else f'{value:g}'})"
            for name, value in lacking.items()
        )
        raise ConfigurationError(
            f"speed: expected speed limits of 0 to {_PLACEHOLDER_RAD_S:g} rad/s, got {said}: give "
            f"real ones by --speed RAD_S (for all of these) or --speed {next(iter(lacking))}=RAD_S"
        )
