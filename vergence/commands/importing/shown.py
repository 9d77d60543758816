"""Printed results of `vergence import`: values read, assumptions made, parts left out."""

from collections.abc import Callable, Iterable
from itertools import starmap
from pathlib import Path
from typing import Final, TypeVar

from vergence.commands.assumed import AssumedValue, assumed_values, label_without_unit
from vergence.commands.head_tables import (
    print_assumptions,
    print_cameras,
    warn_of_lens_folds,
    warn_of_zero_outside_range,
)
from vergence.eval.head_summary import (
    EyeSummary,
    JointSummary,
    baseline_mm,
    coupled_actuator_summaries,
    eye_summaries,
    joint_summaries,
)
from vergence.models.head import HeadModel
from vergence.models.urdf.import_urdf import ImportedHead

_T = TypeVar("_T")


def print_imported_head(imported: ImportedHead, path: Path) -> None:
    """Print a short summary of a head imported from a robot's description, and what to check."""
    head, chains = imported.head, imported.chains
    joints, eyes = joint_summaries(head), eye_summaries(head)
    warn_of_zero_outside_range(joints)
    warn_of_lens_folds(eyes)
    what = "names, ranges and speeds in degrees, what was assumed"
    print(f"head {head.name}, to be checked: {what}, {path}")
    parts = _grouped(joints, lambda joint: joint.moves)
    for line in (("neck",), ("both eyes",), ("left eye", "right eye")):
        said = [f"{part}: {', '.join(map(_range, parts[part]))}" for part in line if part in parts]
        if said:
            print("; ".join(said))
    actuators = coupled_actuator_summaries(head)
    if actuators:
        print(f"actuators of the eyes: {', '.join(map(_range, actuators))}")
    if chains.fixed_values:
        held = ", ".join(f"{name} at {value:.6g}" for name, value in chains.fixed_values.items())
        print(f"held, at rad or m: {held}")
    print(f"cameras: {' and '.join(dict.fromkeys(map(_camera, eyes)))}, ", end="")
    print(f"{baseline_mm(head):.2f} mm apart at rest")
    _print_assumed(assumed_values(head))
    print(f"left out: {'; '.join(imported.ignored)}")


def _grouped(members: Iterable[_T], key: Callable[[_T], str]) -> dict[str, list[_T]]:
    groups: dict[str, list[_T]] = {}
    for member in members:
        groups.setdefault(key(member), []).append(member)
    return groups


def _range(joint: JointSummary) -> str:
    speed = f"{joint.velocity_deg_s:.0f}/s"
    return f"{joint.name} {joint.lower_deg:.1f} to {joint.upper_deg:.1f} at {speed}"


def _camera(eye: EyeSummary) -> str:
    size = f"{eye.width_px} x {eye.height_px} px"
    return f"{size}, {eye.horizontal_deg:.1f} x {eye.vertical_deg:.1f} degrees, {eye.lens}"


_GROUPS: Final = {
    "image": "cameras",
    "eyes": "cameras",
    "timing": "timing",
    "sensor": "simulation",
    "rendering": "simulation",
    "joints": "joint limits",
    "actuators": "joint limits",
}
"""Group of assumptions to check together, by the table of the head file."""


def _print_assumed(assumptions: Iterable[AssumedValue]) -> None:
    groups = _grouped(assumptions, lambda one: _GROUPS.get(one.keys[0].split(".")[0], "others"))
    for group, members in groups.items():
        count = sum(len(one.keys) for one in members)
        fields = _grouped(members, lambda one: label_without_unit(one.keys[0].rpartition(".")[2]))
        print(f"assumed, {group} ({count}): {'; '.join(starmap(_values, fields.items()))}")


def _values(field: str, members: list[AssumedValue]) -> str:
    """Field with its distinct values; the field alone if the values are long."""
    values = " or ".join(dict.fromkeys(one.value for one in members))
    return f"{field} {values}".rstrip() if len(values) <= _MAX_VALUES_LENGTH else field


_MAX_VALUES_LENGTH: Final = 40
"""Longest values that are printed with their field, characters (chosen: detail against length)."""


def print_imported_pair(head: HeadModel) -> None:
    """Print the cameras of an imported pair, and what was assumed."""
    eyes = eye_summaries(head)
    print_cameras(eyes)
    print(f"baseline {baseline_mm(head):.2f} mm at rest\n")
    warn_of_lens_folds(eyes)
    print_assumptions(assumed_values(head))


def print_measured_head(head: HeadModel, path: Path) -> None:
    """Print a summary of a head measured with a ruler."""
    joints, eyes = joint_summaries(head), eye_summaries(head)
    print(f"head {head.name}: {', '.join(map(_range, joints))} degrees")
    print(f"cameras: {' and '.join(dict.fromkeys(map(_camera, eyes)))}, ", end="")
    print(f"{baseline_mm(head):.2f} mm apart at rest")
    _print_assumed(assumed_values(head))
    print(f"correct in {path} what you know better")
