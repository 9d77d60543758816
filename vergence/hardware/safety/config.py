"""Bounds set by a robot's owner: the `[safety]` section of a hardware configuration.

Each key may be left out; without its own bounds a joint has those of the head file.

    [safety]
    speed_rad_s = 3.0               # of every joint; by default the head's own
    acceleration_rad_s2 = 40.0
    image_age_s = 0.5               # stop after this time without an image
    lost_s = 0.5                    # hold after this time without the target
    search = true                   # then search for it slowly
    overruns = 0.3                  # stop if a greater fraction of 2 s is missed
    view_check = true               # before the first gaze, see `vergence.hardware.view_check`

    [[safety.forbidden]]            # an eye that would touch the head
    name = "left eye at the frame"
    left_pan = [0.9, 1.2]
    left_tilt = [-1.2, -0.4]

A posture is forbidden only where all of its angles are in their ranges.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf
from typing import Final

import numpy as np

from vergence.errors import HeadFileError
from vergence.models.parts import FloatArray
from vergence.models.toml_table import Rule, Table

_SPEED_RULE: Final[Rule] = (lambda x: 0.05 <= x <= 100.0, "rad/s, 0.05 to 100 (is it in degrees?)")
_ACCELERATION_RULE: Final[Rule] = (
    lambda x: 0.1 <= x <= 1e4,
    "rad/s^2, 0.1 to 10000 (is it in degrees?)",
)
_SECONDS_RULE: Final[Rule] = (
    lambda x: 0.05 <= x <= 60.0,
    "seconds, 0.05 to 60 (is it in milliseconds?)",
)
_SHARE_RULE: Final[Rule] = (lambda x: 0.0 < x <= 1.0, "a share of the periods, above 0 to 1")
_ANGLE_RULE: Final[Rule] = (lambda x: -10.0 <= x <= 10.0, "an angle, rad (is it in degrees?)")


@dataclass(frozen=True, kw_only=True, eq=False)
class ForbiddenPosture:
    """Postures that cause damage: those with all of the given angles inside their ranges."""

    name: str
    """Name in messages."""
    slots: tuple[int, ...]
    """Indices of its angles in the 7-element command."""
    lower: FloatArray
    """(n,) lower ends of the ranges of these angles, rad."""
    upper: FloatArray
    """(n,) upper ends, rad."""

    def contains(self, angles: FloatArray) -> bool:
        """True if a posture, (7,) rad, is forbidden; the ends of the ranges count as inside."""
        own = angles[list(self.slots)]
        return bool(((own >= self.lower) & (own <= self.upper)).all())

    def refusal(self, angles: FloatArray, names: Mapping[str, int]) -> str:
        """Error message for a posture that is forbidden.

        Args:
            angles: (7,) the posture, rad.
            names: indices into it by name of joint or actuator.
        """
        own = ", ".join(
            f"{name} {angles[slot]:.3f} rad" for name, slot in names.items() if slot in self.slots
        )
        return f"expected no posture of {self.name!r}, got {own}"


@dataclass(frozen=True, kw_only=True)
class SafetyConfig:
    """Bounds of a robot in addition to those of its head file."""

    speed_rad_s: float = inf
    """Greatest speed of any joint, rad/s; the head's own if that is less."""
    acceleration_rad_s2: float = inf
    """Greatest acceleration of any joint, rad/s^2; the head's own if that is less."""
    image_age_s: float = 0.5
    """Time without a new image of an eye after which the head stops, s."""
    lost_s: float = 0.5
    """Time without the target in any eye after which the head holds still, s."""
    search: bool = False
    """True if the head, after `lost_s`, searches slowly for its target instead of holding still."""
    overruns: float = 0.3
    """Greatest fraction of missed control periods in the last 2 s."""
    view_check: bool = True
    """True to compare what the images do with the configuration before the first gaze."""
    forbidden: tuple[ForbiddenPosture, ...] = ()
    """Forbidden postures; commands that lead into one are limited."""


def parse_safety(table: Table, slots: Mapping[str, int]) -> SafetyConfig:
    """Read the `[safety]` section.

    Args:
        table: the section.
        slots: indices into the 7-element command by name of joint or actuator.

    Raises:
        HeadFileError: a key is unknown or impossible.
    """
    values: dict[str, float] = {
        name: table.number(name, rule)
        for name, rule in (
            ("speed_rad_s", _SPEED_RULE),
            ("acceleration_rad_s2", _ACCELERATION_RULE),
            ("image_age_s", _SECONDS_RULE),
            ("lost_s", _SECONDS_RULE),
            ("overruns", _SHARE_RULE),
        )
        if table.has(name)
    }
    search = table.boolean("search")
    view_check = not table.has("view_check") or table.boolean("view_check")
    forbidden: tuple[ForbiddenPosture, ...] = ()
    if table.has("forbidden"):
        forbidden = tuple(_forbidden(one, slots) for one in table.tables("forbidden"))
    table.close()
    return SafetyConfig(search=search, view_check=view_check, forbidden=forbidden, **values)


def _forbidden(table: Table, slots: Mapping[str, int]) -> ForbiddenPosture:
    name = table.text("name", "what the posture would hurt, in words")
    ranges: dict[int, FloatArray] = {}
    for joint, slot in slots.items():
        if table.has(joint):
            ends = table.numbers(joint, (2,), _ANGLE_RULE)
            if not ends[0] < ends[1]:
                raise HeadFileError(
                    table.key(joint), ends.tolist(), "a lower and a greater angle, rad"
                )
            ranges[slot] = ends
    if not ranges:
        raise HeadFileError(table.key("name"), name, f"a range of {', '.join(slots)} beside it")
    table.close()
    lower, upper = np.array(list(ranges.values())).T
    return ForbiddenPosture(name=name, slots=tuple(ranges), lower=lower, upper=upper)
