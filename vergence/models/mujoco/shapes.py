"""Visible shapes without mass or contacts, and the materials of a head."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from vergence.models.mujoco.library import mujoco

SHELL: Final = "shell"
METAL: Final = "metal"
DARK: Final = "dark"
LENS: Final = "lens"
COLOURS: Final = {
    SHELL: (0.80, 0.82, 0.85, 1.0),
    METAL: (0.45, 0.47, 0.50, 1.0),
    DARK: (0.13, 0.14, 0.16, 1.0),
    LENS: (0.05, 0.12, 0.28, 1.0),
}
_SHININESS: Final = {SHELL: 0.4, METAL: 0.7, DARK: 0.3, LENS: 0.9}

VISUAL_ONLY: Final = {"contype": 0, "conaffinity": 0, "mass": 0.0}


def add_materials(spec: mujoco.MjSpec) -> None:
    """Add the materials of the head's shapes."""
    for name, rgba in COLOURS.items():
        spec.add_material(name=name, rgba=rgba, shininess=_SHININESS[name], specular=0.4)


def add_segment(
    body: Any,
    material_or_colour: str | Sequence[float],
    start: Any,
    end: Any,
    radius: float,
    kind: mujoco.mjtGeom = mujoco.mjtGeom.mjGEOM_CYLINDER,
) -> None:
    """Add a cylinder or a capsule between two points, see `add_shape`."""
    ends = np.concatenate([start, end])
    add_shape(body, kind, material_or_colour, size=[radius, 0.0, 0.0], fromto=ends)


def add_shape(
    body: Any, kind: mujoco.mjtGeom, material_or_colour: str | Sequence[float], **where: Any
) -> None:
    """Add a shape with a material of the head, or with a colour of its own.

    The surroundings use colours, not the head's materials, so both can be in separate files.
    """
    colour = (
        {"material": material_or_colour}
        if isinstance(material_or_colour, str)
        else {"rgba": material_or_colour}
    )
    body.add_geom(type=kind, **colour, **where, **VISUAL_ONLY)
