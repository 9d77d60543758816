"""Joint limits of an imported head: from the file, given by the user, or assumed."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from vergence.errors import ConfigurationError
from vergence.models.files.head_rules import ACCELERATION, RADIANS, SPEED
from vergence.models.files.robot_description.actuators import MotionLimits
from vergence.models.files.robot_description.given import ValueByJoint, parse_per_joint
from vergence.models.files.robot_description.mechanism import Joint

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
