"""Random model errors: heads that differ from the model that a controller has."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vergence.errors import ConfigurationError, refuse_unknown
from vergence.models.geometry import Geometry, Links, geometry_with, parameters_of
from vergence.models.parts import EYE_NAMES, FloatArray

_WRONG_UNIT_LIMITS: Final = {
    # a third of such heads are off by more than 29 degrees: half the field of view of a common
    # camera
    "_rad": (0.5, "radians", "degrees"),
    # about the baseline between the eyes
    "_m": (0.1, "metres", "millimetres"),
}
"""By unit: the least standard deviation that is rejected, its unit, and the one probably meant."""


@dataclass(frozen=True, kw_only=True)
class ModelErrors:
    """Standard deviations of a head's errors against its model, all independent and normal.

    The sources are those of the article. The neck's links move N itself and are not changed.

    Examples:
        Joint offsets of 0.01 rad shift the point at which the axes cross by centimetres:

        >>> import numpy as np, vergence
        >>> head = vergence.load_head("simulated")
        >>> errors = vergence.ModelErrors(joint_offset_rad=0.01)
        >>> true_head = head.perturbed(np.random.default_rng(0), errors)
        >>> vergence.triangulate_gaze(true_head, head.fixate([0.0, -0.1, 1.0])).point.round(2)
        array([ 0.  , -0.1 ,  0.95])
    """

    link_m: float = 0.0
    """Standard deviation of the eyes' link lengths and offsets (a and d of frames 4 to 9), m."""
    coaxiality_rad: float = 0.0
    """Standard deviation of the eyes' link twists (alpha of frames 4 to 9), rad."""
    joint_offset_rad: float = 0.0
    """Standard deviation of the eyes' joint offsets, rad."""
    head_eye_rad: float = 0.0
    """Standard deviation of the camera's rotation in its eye, about each axis, rad."""
    head_eye_m: float = 0.0
    """Standard deviation of the camera's position in its eye, along each axis, m."""
    focal_relative: float = 0.0
    """Relative standard deviation of the focal lengths; one draw for both axes of a camera."""
    principal_px: float = 0.0
    """Standard deviation of each coordinate of the principal points, px."""
    distortion: float = 0.0
    """Standard deviation of the first two radial coefficients k1 and k2."""
    common_tilt_rad: float = 0.0
    """Standard deviation of a downward tilt of both eyes that no encoder measures and no
    calibration between the cameras can observe, rad."""

    def __post_init__(self) -> None:
        for key, value in vars(self).items():
            number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
            if not (number and np.isfinite(value) and value >= 0.0):
                raise ConfigurationError(
                    f"ModelErrors.{key}: expected a standard deviation >= 0, got {value!r}"
                )
            for ending, (most, unit, other) in _WRONG_UNIT_LIMITS.items():
                if key.endswith(ending) and value >= most:
                    raise ConfigurationError(
                        f"ModelErrors.{key}: expected a standard deviation below {most:g} {unit}, "
                        f"got {value!r} (is it in {other}?)"
                    )

    def scaled(self, factor: float) -> "ModelErrors":
        """Multiply all standard deviations by one factor."""
        return ModelErrors(**{key: factor * value for key, value in vars(self).items()})


def as_model_errors(errors: Mapping[str, float] | ModelErrors, name: str) -> ModelErrors:
    """Make model errors from standard deviations by field; `name` is theirs in messages."""
    if isinstance(errors, ModelErrors):
        return errors
    if not isinstance(errors, Mapping):
        raise ConfigurationError(
            f"{name}: expected standard deviations by name, got {errors!r:.80}"
        )
    refuse_unknown(name, errors, ModelErrors.__dataclass_fields__)
    return ModelErrors(**errors)


def _links(field: str) -> list[str]:
    """Parameter names of one field for the nine links; empty for the neck's, which stay."""
    return ["", "", "", *_eyes(f"tilt.{field}", f"pan.{field}", f"camera_link.{field}")]


def _eyes(*names: str) -> list[str]:
    return [f"{eye}.{name}" for eye in EYE_NAMES for name in names]


_DEVIATE_LAYOUT: Final = (
    ("link_m", _links("a")),
    ("link_m", _links("d")),
    ("coaxiality_rad", ["left.1.ry", "right.1.ry", "", *_links("alpha")[3:]]),
    ("joint_offset_rad", _links("offset")),
    ("head_eye_rad", _eyes("head_eye.rx", "head_eye.ry", "head_eye.rz")),
    ("head_eye_m", _eyes("head_eye.x", "head_eye.y", "head_eye.z")),
    ("focal_relative", _eyes("camera.f")),
    ("principal_px", _eyes("camera.u_0", "camera.v_0")),
    ("distortion", _eyes("camera.k1", "camera.k2", "", "", "")),
    ("common_tilt_rad", [""]),
)
"""The standard normal numbers of a head, in the order of drawing: the error of each, and the
parameter it moves (empty for none)."""

_DEVIATES: Final = [(error, name) for error, names in _DEVIATE_LAYOUT for name in names]
_DEVIATE_OF_PARAMETER: Final = {
    name: (error, place) for place, (error, name) in enumerate(_DEVIATES)
}
"""By parameter: its error, and the index of its standard normal number."""

_SOURCE_OF_PARAMETER: Final = {
    f"{part}.{own}": f"{eye}.{source}"
    for part, eye in (("left", "left"), ("right", "right"), ("both", "left"))
    for own, source in (
        ("1.x", "tilt.a"), ("1.y", "tilt.d"), ("1.z", "camera_link.a"),
        ("2.x", "pan.a"), ("2.y", "pan.d"), ("2.z", "camera_link.d"),
        ("1.rx", "tilt.alpha"), ("2.rx", "pan.alpha"), ("2.ry", "camera_link.alpha"),
        ("1.rz", "tilt.offset"), ("2.rz", "pan.offset"), ("1.ry", "1.ry"),
        ("camera.f_u", "camera.f"), ("camera.f_v", "camera.f"),
    )
}  # fmt: skip
"""By parameter: the one whose number it uses. Those of `JointAxes` use the article's links', and
the neck's otherwise unused numbers for rotations `1.ry`; a joint that both eyes share uses the left
eye's; one number moves both focal lengths of a camera."""

_MIN_TILT_COMPONENT: Final = 0.5
"""Least component along x_N of the axis of a joint that tilts (chosen: within 60 degrees)."""

DEVIATES: Final = len(_DEVIATES)
"""Number of standard normal numbers per head."""


def perturb_geometry(
    nominal: Geometry, rng: np.random.Generator, errors: ModelErrors, shape: tuple[int, ...]
) -> Geometry:
    """Draw geometries of batch shape `shape` that differ from the nominal one by random errors."""
    draws = [
        # this error was added last: heads drawn without it stay as they were before
        np.zeros((*shape, len(names)))
        if error == "common_tilt_rad" and errors.common_tilt_rad == 0.0
        else rng.standard_normal((*shape, len(names)))
        for error, names in _DEVIATE_LAYOUT
    ]
    return perturb_by_deviates(nominal, errors, np.concatenate(draws, axis=-1))


def perturb_by_deviates(nominal: Geometry, errors: ModelErrors, deviates: FloatArray) -> Geometry:
    """Perturb the nominal geometry by (..., DEVIATES) standard normal numbers."""
    names, _units, values = parameters_of(nominal)
    sigma, places, relative = _spreads(names, errors)
    deviations = sigma * deviates[..., places]
    # not by `standard_deviations`, so that heads drawn by earlier versions stay equal bit for bit
    values = np.where(relative, values * (1.0 + deviations), values + deviations)
    if errors.common_tilt_rad > 0.0:
        lowered = _lowered(nominal.links, names)
        shares = np.array([lowered.get(name, 0.0) for name in names])
        values += shares * (errors.common_tilt_rad * deviates[..., -1:])
    return geometry_with(nominal, values)


def standard_deviations(nominal: Geometry, errors: ModelErrors) -> FloatArray:
    """(n,) sigma in the order of `parameters_of`, without the common tilt; 0 if none moves it."""
    names, _units, values = parameters_of(nominal)
    sigma, _places, relative = _spreads(names, errors)
    return np.where(relative, np.abs(values) * sigma, sigma)


def _spreads(
    names: tuple[str, ...], errors: ModelErrors
) -> tuple[FloatArray, list[int], NDArray[np.bool_]]:
    """By parameter: sigma, the index of its number, and True if sigma is relative."""
    sources = (_SOURCE_OF_PARAMETER.get(name, name) for name in names)
    moved = [_DEVIATE_OF_PARAMETER.get(source, ("", 0)) for source in sources]
    sigma = np.array([getattr(errors, error, 0.0) for error, _place in moved])
    relative = np.array([error == "focal_relative" for error, _place in moved])
    return sigma, [place for _error, place in moved], relative


@lru_cache(maxsize=8)
def _lowered(links: Links, names: tuple[str, ...]) -> dict[str, float]:
    """By parameter: its change, rad, per radian of a common downward tilt of both eyes."""
    poses, out = links.constant_poses(), {}
    for eye, name in enumerate(EYE_NAMES):
        first = poses[4 + 3 * eye]
        tilts = {}
        for number, pose in ((1, first), (2, first @ poses[5 + 3 * eye])):
            own = f"{name}.{number}.rz"
            for parameter in (own, f"both.{number}.rz", _SOURCE_OF_PARAMETER[own]):
                if parameter in names:
                    tilts[parameter] = float(pose[0, 2])
        best = max(tilts, key=lambda key: abs(tilts[key]), default="")
        if best and abs(tilts[best]) > _MIN_TILT_COMPONENT:
            out[best] = -float(np.sign(tilts[best]))  # about x_N, y turns to z: the eye looks up
        else:
            out[f"{name}.head_eye.rx"] = -1.0
    return out
