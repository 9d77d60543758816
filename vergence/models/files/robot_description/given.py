"""Numbers that somebody gives by joint: `JOINT=NUMBER UNIT`, or one number for all."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from vergence.errors import ConfigurationError
from vergence.models.files.robot_description.mechanism import Joint, among

_NUMBER: Final = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([a-z]*)\s*")
_TURNS: Final = {"": np.pi / 180.0, "deg": np.pi / 180.0, "rad": 1.0}
_SLIDES: Final = {"m": 1.0, "mm": 1e-3}


def locked_joints(words: Sequence[str], joints: Mapping[str, Joint]) -> dict[str, float]:
    """Where joints are held, radians or metres, from `JOINT=DEG`, `JOINT=1.5rad`, `JOINT=0.1m`.

    Args:
        words: as given.
        joints: those of the robot, by name.

    Raises:
        ConfigurationError: a word is no such thing, a joint is unknown, or is given twice.
    """
    found: dict[str, float] = {}
    for word in words:
        name, equals, text = word.rpartition("=")
        if not equals:
            raise ConfigurationError(f"lock: expected JOINT=DEG, got {word!r}")
        if name not in joints:
            raise ConfigurationError(f"lock: expected {among('joint', name, joints)}, got {name!r}")
        if name in found:
            raise ConfigurationError(f"lock: expected each joint once, got {name} twice")
        slides = joints[name].kind == "slide"
        units = _SLIDES if slides else _TURNS
        parts = _NUMBER.fullmatch(text)
        if parts is None or parts[2] not in units:
            example = f"{name}=0.1m" if slides else f"{name}=10, in degrees"
            raise ConfigurationError(f"lock: expected a place such as {example}, got {word!r}")
        found[name] = float(parts[1]) * units[parts[2]]
    return found


@dataclass(frozen=True)
class Given:
    """Numbers that somebody gives of joints.

    Attributes:
        each: by joint.
        others: for joints that are not among these; None where there is none.
    """

    each: Mapping[str, float]
    others: float | None


def given_by_joint(
    option: str,
    words: Sequence[str],
    joints: Sequence[str],
    accepted: Callable[[float], bool],
    expected: str,
) -> Given:
    """Numbers from `NUMBER` and `JOINT=NUMBER`.

    Args:
        option: what messages call it.
        words: as given.
        joints: those that may be named.
        accepted: whether a number may be.
        expected: how a message describes it.

    Raises:
        ConfigurationError: a word is no such thing, a joint is unknown, or is given twice.
    """
    each: dict[str, float] = {}
    others: float | None = None
    for word in words:
        name, equals, text = word.rpartition("=")
        try:
            number = float(text)
        except ValueError:
            number = np.nan
        if np.isnan(number) or not accepted(number):
            raise ConfigurationError(f"{option}: expected {expected}, got {word!r}")
        if equals and name not in joints:
            raise ConfigurationError(
                f"{option}: expected {among('moving joint', name, joints)}, got {name!r}"
            )
        if name in each or (not equals and others is not None):
            raise ConfigurationError(f"{option}: expected one number a joint, got {word!r} too")
        if equals:
            each[name] = number
        else:
            others = number
    return Given(each, others)
