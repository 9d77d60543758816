"""Geometry parameters of a head as a vector with names and units, and back.

The parameters are the numbers in which a real head differs from its model. The description of the
axes (`vergence.models.links.Links`) states its own parameters: names, units and the element of a
field that holds each. The vector also contains the head-eye transforms, as a rotation vector and a
position each, and the cameras. The neck's links are left out, as they move N itself. Perturbation
and calibration work on this vector alone.

No three numbers parametrise rotations smoothly everywhere. The rotation vector r of a head-eye
transform is therefore relative to a given head: `R = R_given exp([r])`; r is zero for that head.
"""

import dataclasses
from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from vergence.models.cameras import Cameras
from vergence.models.joints import EYE_NAMES
from vergence.models.links import Links
from vergence.models.parts import FloatArray, Parameter
from vergence.operands import as_operand

_HEAD_EYE: Final = tuple(
    Parameter(f"{eye}.head_eye.{name}", unit, field, 3 * i + j)
    for i, eye in enumerate(EYE_NAMES)
    for field, unit, names in (
        ("rotation", "rad", ("rx", "ry", "rz")),
        ("position", "m", ("x", "y", "z")),
    )
    for j, name in enumerate(names)
)


_CAMERA_FIELDS: Final = ("focal", "principal", "distortion")


class Geometry(NamedTuple):
    """The parts in which a real head differs from its model."""

    links: Links
    head_eye: FloatArray
    """(..., 2, 4, 4): poses of the cameras in the eyes' last links."""
    cameras: Cameras


class Parameters(NamedTuple):
    """A head's geometry as a vector."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: FloatArray
    """(..., n): one vector per head."""


def parameters_of(geometry: Geometry, reference: Geometry | None = None) -> Parameters:
    """Flatten a geometry; rotation vectors are relative to `reference`, by default to itself."""
    parameters = _parameters(geometry)
    fields = _fields(geometry, geometry if reference is None else reference)
    batch = np.broadcast_shapes(*(field.shape[:-1] for field in fields.values()))
    values = np.empty((*batch, len(parameters)))
    for name, (columns, places) in _places(parameters).items():
        values[..., places] = fields[name][..., columns]
    return Parameters(
        tuple(parameter.name for parameter in parameters),
        tuple(parameter.unit for parameter in parameters),
        values,
    )


def geometry_with(reference: Geometry, values: ArrayLike) -> Geometry:
    """Rebuild a geometry from (..., n) `parameters_of`; the neck is copied from the reference."""
    parameters = _parameters(reference)
    vector = as_operand("values", values, len(parameters))
    batch = vector.shape[:-1]
    fields = {
        name: np.broadcast_to(field, (*batch, field.shape[-1])).copy()
        for name, field in _fields(reference, reference).items()
    }
    for name, (columns, places) in _places(parameters).items():
        fields[name][..., columns] = vector[..., places]
    from scipy.spatial.transform import Rotation

    rotation = Rotation.from_rotvec(fields["rotation"].reshape(-1, 3)).as_matrix()
    head_eye = np.broadcast_to(reference.head_eye, (*batch, 2, 4, 4)).copy()
    head_eye[..., :3, :3] @= rotation.reshape(*batch, 2, 3, 3)
    head_eye[..., :3, 3] = fields["position"].reshape(*batch, 2, 3)
    cameras: dict[str, Any] = {name: fields[name].reshape(*batch, 2, -1) for name in _CAMERA_FIELDS}
    return Geometry(
        reference.links.with_fields(fields),
        head_eye,
        dataclasses.replace(reference.cameras, **cameras),
    )


def _parameters(geometry: Geometry) -> tuple[Parameter, ...]:
    return (*geometry.links.parameters, *_HEAD_EYE, *geometry.cameras.parameters)


@lru_cache(maxsize=8)
def _places(parameters: tuple[Parameter, ...]) -> dict[str, tuple[list[int], list[int]]]:
    """By field: the columns that hold parameters, and the parameters' indices in the vector."""
    groups: dict[str, tuple[list[int], list[int]]] = {}
    for place, parameter in enumerate(parameters):
        columns, places = groups.setdefault(parameter.field, ([], []))
        columns.append(parameter.column)
        places.append(place)
    return groups


def _fields(geometry: Geometry, reference: Geometry) -> dict[str, FloatArray]:
    """Every field that holds parameters, by name, with its own dimensions flattened."""
    links, head_eye, cameras = geometry
    rotation = np.zeros((2, 3))
    if reference is not geometry:
        relative = np.swapaxes(reference.head_eye[..., :3, :3], -1, -2) @ head_eye[..., :3, :3]
        from scipy.spatial.transform import Rotation

        vectors = Rotation.from_matrix(relative.reshape(-1, 3, 3)).as_rotvec()
        rotation = vectors.reshape(*relative.shape[:-2], 3)
    pairs = {name: getattr(cameras, name) for name in _CAMERA_FIELDS}
    pairs |= {"rotation": rotation, "position": head_eye[..., :3, 3]}
    return links.fields(reference.links) | {
        name: pair.reshape(*pair.shape[:-2], pair.shape[-2] * pair.shape[-1])
        for name, pair in pairs.items()
    }
