"""Bounds that a robot's owner sets: the `[safety]` section of a hardware configuration.

Each key may be left out; a joint's bounds are the head's own then.

    [safety]
    speed_rad_s = 3.0               # of every joint; the head's own where left out
    acceleration_rad_s2 = 40.0
    image_age_s = 0.5               # stop without an image for so long
    lost_s = 0.5                    # hold when no eye has seen the target for so long
    search = true                   # and then look around for it, slowly
    overruns = 0.3                  # stop when more of the periods of 2 s are missed

    [[safety.forbidden]]            # an eye against the head: all of it at once is forbidden
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
from vergence.models.files.toml_table import Rule, Table
from vergence.models.parts import FloatArray

_SPEED: Final[Rule] = (lambda x: 0.05 <= x <= 100.0, "rad/s, 0.05 to 100 (is it in degrees?)")
_ACCELERATION: Final[Rule] = (
    lambda x: 0.1 <= x <= 1e4,
    "rad/s^2, 0.1 to 10000 (is it in degrees?)",
)
_SECONDS: Final[Rule] = (
    lambda x: 0.05 <= x <= 60.0,
    "seconds, 0.05 to 60 (is it in milliseconds?)",
)
_SHARE: Final[Rule] = (lambda x: 0.0 < x <= 1.0, "a share of the periods, above 0 to 1")
_ANGLE: Final[Rule] = (lambda x: -10.0 <= x <= 10.0, "an angle, rad (is it in degrees?)")


@dataclass(frozen=True, kw_only=True, eq=False)
class ForbiddenPosture:
    """Postures in which something is hurt: those with all of some angles in their ranges."""

    name: str
    """As messages call it."""
    slots: tuple[int, ...]
    """Places in a command of seven of the angles that it is about."""
    lower: FloatArray
    """(n,) least angles of these, rad."""
    upper: FloatArray
    """(n,) greatest angles, rad."""

    def holds(self, angles: FloatArray) -> bool:
        """Membership of a posture, (7,) rad; its faces belong to it."""
        own = angles[list(self.slots)]
        return bool(((own >= self.lower) & (own <= self.upper)).all())

    def refusal(self, angles: FloatArray, names: Mapping[str, int]) -> str:
        """What was expected and what came, where a posture, (7,) rad, is in it.

        Args:
            angles: the posture.
            names: places in it by name of joint or actuator.
        """
        own = ", ".join(
            f"{name} {angles[slot]:.3f} rad" for name, slot in names.items() if slot in self.slots
        )
        return f"expected no posture of {self.name!r}, got {own}"


@dataclass(frozen=True, kw_only=True)
class SafetyConfig:
    """Bounds of a robot beyond those of its head file."""

    speed_rad_s: float = inf
    """Greatest speed of any joint, rad/s; the head's own where that is less."""
    acceleration_rad_s2: float = inf
    """Greatest acceleration of any joint, rad/s^2; the head's own where that is less."""
    image_age_s: float = 0.5
    """Time without a new image of an eye after which the head stops, s."""
    lost_s: float = 0.5
    """Time without the target in any eye after which the head holds still, s."""
    search: bool = False
    """Whether a head that has held still for `lost_s` looks around for its target, slowly."""
    overruns: float = 0.3
    """Share of the last 2 s' control periods that may be missed."""
    forbidden: tuple[ForbiddenPosture, ...] = ()
    """Postures that no command leads into."""


def parse_safety(table: Table, slots: Mapping[str, int]) -> SafetyConfig:
    """Read the `[safety]` section.

    Args:
        table: the section.
        slots: places in a command of seven, by name of joint or actuator.

    Raises:
        HeadFileError: a key is unknown or impossible.
    """
    values: dict[str, float] = {
        name: table.number(name, rule)
        for name, rule in (
            ("speed_rad_s", _SPEED),
            ("acceleration_rad_s2", _ACCELERATION),
            ("image_age_s", _SECONDS),
            ("lost_s", _SECONDS),
            ("overruns", _SHARE),
        )
        if table.has(name)
    }
    search = table.flag("search")
    forbidden: tuple[ForbiddenPosture, ...] = ()
    if table.has("forbidden"):
        forbidden = tuple(_forbidden(one, slots) for one in table.tables("forbidden"))
    table.close()
    return SafetyConfig(search=search, forbidden=forbidden, **values)


def _forbidden(table: Table, slots: Mapping[str, int]) -> ForbiddenPosture:
    name = table.text("name", "what the posture would hurt, in words")
    ranges: dict[int, FloatArray] = {}
    for joint, slot in slots.items():
        if table.has(joint):
            ends = table.numbers(joint, (2,), _ANGLE)
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
