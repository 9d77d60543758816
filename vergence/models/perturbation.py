"""Heads that differ from their model: the errors that a controller does not know."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from vergence.errors import ConfigurationError
from vergence.models.joints import LINKS
from vergence.models.parts import Cameras, DenavitHartenberg, FloatArray

_JOINTED = np.array([True, True, True, True, True, False, True, True, False])
# a positive left tilt looks down, a positive right tilt up
_LOWERS: Final = np.array(
    [{"left_tilt": 1.0, "right_tilt": -1.0}.get(joint, 0.0) for _f, _p, joint in LINKS]
)

DEVIATES: Final = 4 * 9 + 2 * 3 + 2 * 3 + 2 + 2 * 2 + 2 * 5 + 1
"""How many standard normal numbers make a head."""


@dataclass(frozen=True, kw_only=True)
class ModelErrors:
    """Standard deviations of a head's deviations from its model, all independent and normal.

    The sources are those the article names: link length, coaxiality, joint offsets,
    head-eye, intrinsics. The neck's links move N itself and are left as they are.
    """

    link_m: float = 0.0
    """Of the eyes' link lengths and offsets (a and d of frames 4 to 9), in metres."""
    coaxiality_rad: float = 0.0
    """Of the eyes' link twists (alpha of frames 4 to 9), in radians."""
    joint_offset_rad: float = 0.0
    """Of the eyes' joint offsets, in radians."""
    head_eye_rad: float = 0.0
    """Of the camera's rotation in its eye, about each axis, in radians."""
    head_eye_m: float = 0.0
    """Of the camera's position in its eye, along each axis, in metres."""
    focal_relative: float = 0.0
    """Of the focal lengths, as a fraction; one draw for both axes of a camera."""
    principal_px: float = 0.0
    """Of the principal points, each coordinate, in pixels."""
    distortion: float = 0.0
    """Of the first two radial coefficients k1 and k2."""
    common_tilt_rad: float = 0.0
    """Of what both eyes look lower than their encoders say, in radians: no calibration between
    the two cameras sees it."""

    def __post_init__(self) -> None:
        for key, value in vars(self).items():
            if not (np.isfinite(value) and value >= 0.0):
                raise ConfigurationError(
                    f"ModelErrors.{key}: expected a standard deviation >= 0, got {value!r}"
                )

    def scaled(self, factor: float) -> "ModelErrors":
        """All deviations multiplied by one factor."""
        return ModelErrors(**{key: factor * value for key, value in vars(self).items()})


class Geometry(NamedTuple):
    """The parts of a head that are never quite what its model says."""

    links: DenavitHartenberg
    head_eye: FloatArray
    cameras: Cameras


def perturb_geometry(
    nominal: Geometry,
    rng: np.random.Generator,
    errors: ModelErrors,
    shape: tuple[int, ...],
) -> Geometry:
    """Draw geometries that differ from the nominal one by random errors.

    Args:
        nominal: the geometry of one head.
        rng: the source of randomness.
        errors: how large the errors are.
        shape: the population's shape, () for one head.

    Returns:
        A geometry with the batch shape `shape`.
    """
    return _deviate(nominal, errors, shape, lambda *tail: rng.standard_normal((*shape, *tail)))


def perturb_by(nominal: Geometry, errors: ModelErrors, deviates: FloatArray) -> Geometry:
    """Geometries that differ from the nominal one by given errors.

    Args:
        nominal: the geometry of one head.
        errors: how large the errors are.
        deviates: (n, DEVIATES) standard normal numbers, a row a head.

    Returns:
        A geometry with the batch shape (n,).
    """
    used = 0

    def take(*tail: int) -> FloatArray:
        nonlocal used
        size = int(np.prod(tail))
        part = deviates[:, used : used + size]
        used += size
        return part.reshape(-1, *tail)

    return _deviate(nominal, errors, (len(deviates),), take)


def _deviate(
    nominal: Geometry,
    errors: ModelErrors,
    shape: tuple[int, ...],
    draw: Callable[..., FloatArray],
) -> Geometry:
    links, head_eye, cameras = nominal
    eyes = np.arange(9) >= 3

    def normal(sigma: float, *tail: int) -> FloatArray:
        return sigma * draw(*tail)

    a, d = normal(errors.link_m, 9), normal(errors.link_m, 9)
    alpha, offset = normal(errors.coaxiality_rad, 9), normal(errors.joint_offset_rad, 9)
    turn = Rotation.from_rotvec(normal(errors.head_eye_rad, 2, 3).reshape(-1, 3))
    new_head_eye = np.broadcast_to(head_eye, (*shape, 2, 4, 4)).copy()
    new_head_eye[..., :3, :3] @= turn.as_matrix().reshape(*shape, 2, 3, 3)
    new_head_eye[..., :3, 3] += normal(errors.head_eye_m, 2, 3)
    radial = np.array([1.0, 1.0, 0.0, 0.0, 0.0])
    new_cameras = dataclasses.replace(
        cameras,
        focal=cameras.focal * (1.0 + normal(errors.focal_relative, 2, 1)),
        principal=cameras.principal + normal(errors.principal_px, 2, 2),
        distortion=cameras.distortion + radial * normal(errors.distortion, 2, 5),
    )
    new_offset = links.offset + (eyes & _JOINTED) * offset
    if errors.common_tilt_rad > 0.0:
        new_offset = new_offset + _LOWERS * normal(errors.common_tilt_rad, 1)
    new_links = dataclasses.replace(
        links,
        a=links.a + eyes * a,
        d=links.d + eyes * d,
        alpha=links.alpha + eyes * alpha,
        offset=new_offset,
    )
    return Geometry(new_links, new_head_eye, new_cameras)
