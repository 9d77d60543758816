"""Populations of heads: stacking geometries, and selecting from a stack."""

import dataclasses
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from vergence.errors import ConfigurationError
from vergence.models.links import map_arrays
from vergence.models.parameters import Geometry
from vergence.models.parts import FloatArray, replace_fields

_CAMERA_FIELDS: Final = ("focal", "principal", "distortion")


def pick_geometry(geometry: Geometry, batch_shape: tuple[int, ...], index: Any) -> Geometry:
    """Select one geometry, or several, of a population by a NumPy index for its shape."""

    def taken(values: FloatArray, own: int) -> FloatArray:
        full = np.broadcast_to(values, (*batch_shape, *values.shape[values.ndim - own :]))
        return np.asarray(full[index])

    cameras: Any = {name: taken(getattr(geometry.cameras, name), 2) for name in _CAMERA_FIELDS}
    return Geometry(
        map_arrays(geometry.links, taken),
        taken(geometry.head_eye, 3),
        dataclasses.replace(geometry.cameras, **cameras),
    )


def stack_geometries(geometries: Sequence[Geometry]) -> Geometry:
    """Stack geometries of equal shape to a population."""
    first = geometries[0]
    lenses = [geometry.cameras.lens for geometry in geometries]
    if any(lens != lenses[0] for lens in lenses):
        raise ConfigurationError(
            f"stack: expected heads with the lenses of the first, {lenses[0]}, got {lenses!r:.80}"
        )
    joints = [geometry.links.joints for geometry in geometries]
    if any(names != joints[0] for names in joints):
        raise ConfigurationError(
            f"stack: expected heads with the joints of the first, {joints[0]}, got {joints!r:.80}"
        )
    links: Any = {
        name: np.stack([geometry.links.arrays()[name][0] for geometry in geometries])
        for name in first.links.arrays()
    }
    cameras: Any = {
        name: np.stack([getattr(geometry.cameras, name) for geometry in geometries])
        for name in _CAMERA_FIELDS
    }
    return Geometry(
        replace_fields(first.links, "links", links),
        np.stack([geometry.head_eye for geometry in geometries]),
        dataclasses.replace(first.cameras, **cameras),
    )
