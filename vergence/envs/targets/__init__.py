"""Targets to look at, by name: the position of each trial's target as a function of time."""

import dataclasses
from collections.abc import Mapping
from typing import Any, Final

from vergence.envs.targets.motion import Target
from vergence.envs.targets.prescribed import (
    CircleTarget,
    LineTarget,
    StaticTarget,
    StepTarget,
    UnseenTarget,
)
from vergence.envs.targets.pursuit import OccludedTarget, OrbitTarget, WanderTarget
from vergence.envs.targets.workspace import DoubleStepTarget, RandomTarget
from vergence.errors import UnknownNameError, refuse_unknown
from vergence.vision.objects.targets import PlaceTarget, parse_gaze_target

_KINDS: Final[tuple[type[Target], ...]] = (
    StaticTarget, StepTarget, CircleTarget, LineTarget, RandomTarget, DoubleStepTarget,
    OrbitTarget, OccludedTarget, WanderTarget,
)  # fmt: skip
TARGETS: Final = {target.kind: target for target in _KINDS}
"""The kinds of target by name."""


def make_target(target: "str | Mapping[str, Any] | Target") -> Target:
    """Make a target from its name, or `{"kind": "static", "point": [0, -0.1, 1]}`; or keep it."""
    if isinstance(target, Target):
        return target
    fields = dict(target) if isinstance(target, Mapping) else {"kind": target}
    kind = fields.pop("kind", None)
    if not isinstance(kind, str) or kind not in TARGETS:
        raise UnknownNameError("target", kind, sorted(TARGETS))
    known = sorted(field.name for field in dataclasses.fields(TARGETS[kind]))
    refuse_unknown("target", fields, known)
    return TARGETS[kind](**fields)


def separate_look(
    target: "str | Mapping[str, Any] | Target",
) -> "tuple[str | Mapping[str, Any] | Target, str | None]":
    """Separate a target's motion from what is looked at; None for the plant's own.

    A mapping may name what moves as `look`. What `parse_gaze_target` takes, such as
    `colour:#ff8000`, appears anywhere in the workspace if it stands alone.
    """
    if isinstance(target, str) and target not in TARGETS and (":" in target or target == "point"):
        if target.startswith("place:"):
            place = parse_gaze_target(target)
            assert isinstance(place, PlaceTarget)
            x, y, z = place.point_mm
            return UnseenTarget(point=(x / 1000.0, y / 1000.0, z / 1000.0), start="rest"), target
        return "random", target
    if isinstance(target, Mapping) and "look" in target:
        motion = {name: value for name, value in target.items() if name != "look"}
        return motion or "random", str(target["look"])
    return target, None
