"""Parse numbers given per joint, `JOINT=NUMBER` with or without a unit, or one for all joints."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from vergence.errors import ConfigurationError
from vergence.models.files.robot_description.mechanism import Joint, known_names_hint

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
