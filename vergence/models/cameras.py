"""The two cameras of a head: image, pinhole, lens and response of each."""

from dataclasses import dataclass
from functools import lru_cache
from math import isfinite
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError
from vergence.models.parts import EYE_NAMES, FloatArray, Parameter, readonly_array

CameraResponse = str | float | tuple[float, ...]
"""Response: ``"linear"``, ``"srgb"``, a gamma, or a table, see `parse_response`."""
LINEAR: Final = "linear"
SRGB: Final = "srgb"
EXPECTED: Final = (
    "'linear', 'srgb', a gamma from 0.2 to 5 such as 2.2 (light is the level's share to that "
    "power), or a table of the light at levels in equal steps, rising from 0 to 1"
)
"""Description of a valid response, for messages."""
_GAMMA_RANGE: Final = (0.2, 5.0)
"""Least and greatest gamma; those of cameras and displays lie between 1 and 2.6 (chosen: far
beyond)."""
_LEVELS: Final = 256
"""Grey levels of 8 bits (numerical)."""
_MOST_ENTRIES: Final = 65536
"""Most entries of a table, one for each level of 16 bits (numerical)."""


def parse_response(value: Any, name: str = "response") -> CameraResponse:
    """Parse a response from a file, an option or a caller.

    Args:
        value: ``"linear"``: levels are proportional to light. ``"srgb"``: the curve of
            IEC 61966-2-1, which JPEG files, webcams and displays follow. A number g: light is the
            level, as a fraction of the greatest, to the power of g. A table: at least two numbers,
            the light at equally spaced levels from 0 to the greatest, rising from 0 to 1. A number
            or a table may also be given as a string, with commas between a table's numbers.
        name: name of the value in messages.

    Raises:
        ConfigurationError: the value is none of these.
    """
    if isinstance(value, str):
        if value.lower() in (LINEAR, SRGB):
            return value.lower()
        try:
            numbers = [float(part) for part in value.split(",")]
        except ValueError:
            raise ConfigurationError(f"{name}: expected {EXPECTED}, got {value!r:.80}") from None
        value = numbers if len(numbers) > 1 else numbers[0]
    if isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool):
        gamma = float(value)
        if not (isfinite(gamma) and _GAMMA_RANGE[0] <= gamma <= _GAMMA_RANGE[1]):
            raise ConfigurationError(f"{name}: expected {EXPECTED}, got {gamma:g}")
        return LINEAR if gamma == 1.0 else gamma
    try:
        table = np.asarray(value, float)
    except (TypeError, ValueError):
        table = np.empty(0)
    if table.ndim == 1 and any(isinstance(one, str | bool | np.bool_) for one in value):
        table = np.empty(0)
    rises = table.ndim == 1 and 2 <= len(table) <= _MOST_ENTRIES and (np.diff(table) > 0.0).all()
    if not rises or table[0] != 0.0 or table[-1] != 1.0:
        raise ConfigurationError(f"{name}: expected {EXPECTED}, got {value!r:.80}")
    return tuple(table.tolist())


def default_response(*, colour: bool) -> CameraResponse:
    """Response if none is stated: sRGB for colour, linear for grey, from industry or rendering."""
    return SRGB if colour else LINEAR


def to_light(grey_fraction: ArrayLike, response: CameraResponse) -> FloatArray:
    """Convert grey levels to light, both as fractions of the greatest, 0 to 1."""
    grey_fraction = np.asarray(grey_fraction, np.float64)
    if response == LINEAR:
        return grey_fraction
    if response == SRGB:  # IEC 61966-2-1
        return np.where(
            grey_fraction <= 0.04045,
            grey_fraction / 12.92,
            ((grey_fraction + 0.055) / 1.055) ** 2.4,
        )
    if isinstance(response, tuple):
        return np.asarray(np.interp(grey_fraction, np.linspace(0.0, 1.0, len(response)), response))
    return np.asarray(grey_fraction ** float(response))


@lru_cache(maxsize=32)
def light_table(response: CameraResponse) -> FloatArray:
    """(256,) read-only light of each grey level of 8 bits."""
    light = 255.0 * to_light(np.linspace(0.0, 1.0, _LEVELS), response)
    light.setflags(write=False)
    return light


BROWN_CONRADY: Final = "brown-conrady"
PINHOLE: Final = "pinhole"
"""Name, in files and messages, of a Brown-Conrady lens without distortion."""
LENSES: Final[dict[str, tuple[str, ...]]] = {
    BROWN_CONRADY: ("k1", "k2", "p1", "p2", "k3"),
    "rational": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "fisheye": ("k1", "k2", "k3", "k4"),
}
"""The lens models and their coefficients in OpenCV's order, see `vergence.models.lens`."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Cameras:
    """The two cameras: image size, pinhole, lens and response of each.

    Raises:
        ConfigurationError: an image size, a lens, its coefficients or a response is invalid.
    """

    size: NDArray[np.int64]
    """(2, 2): (width, height) of the image per eye, in pixels; one pair applies to both eyes."""
    focal: FloatArray
    """(..., 2, 2): (f_u, f_v) per eye, in pixels."""
    principal: FloatArray
    """(..., 2, 2): (u_0, v_0) per eye, in pixels, pixel centres at integers."""
    distortion: FloatArray
    """(..., 2, n): the coefficients of each eye's lens in OpenCV's order, see `LENSES`. n is 5 for
    two Brown-Conrady lenses, else 8; a lens with fewer coefficients is padded with zeros."""
    lens: tuple[str, str] = (BROWN_CONRADY, BROWN_CONRADY)
    """The lens model of each eye, a key of `LENSES`; one name applies to both eyes."""
    response: tuple[CameraResponse | None, CameraResponse | None] = (None, None)
    """Response of each eye's camera, from grey level to light, see `parse_response`; None if
    unknown. A value that is not a tuple of two applies to both eyes."""

    def __post_init__(self) -> None:
        lens = _pair_of_lenses(self.lens)
        values = {
            "size": _pair_of_sizes(self.size),
            "focal": readonly_array(self.focal),
            "principal": readonly_array(self.principal),
            "distortion": _coefficients(self.distortion, lens),
            "lens": lens,
            "response": _pair_of_responses(self.response),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters of pinhole and lens of both eyes; 18 for two Brown-Conrady lenses."""
        return _camera_parameters(self.lens)


def padded_coefficient_count(lens: tuple[str, str]) -> int:
    """Number of distortion coefficients of both eyes, padded: 5 for Brown-Conrady, else 8."""
    return 5 if lens == (BROWN_CONRADY, BROWN_CONRADY) else 8


@lru_cache(maxsize=16)
def _camera_parameters(lens: tuple[str, str]) -> tuple[Parameter, ...]:
    slots = {"focal": 2, "principal": 2, "distortion": padded_coefficient_count(lens)}
    return tuple(
        Parameter(f"{eye}.camera.{name}", unit, field, slots[field] * i + j)
        for i, eye in enumerate(EYE_NAMES)
        for field, unit, names in (
            ("focal", "px", ("f_u", "f_v")),
            ("principal", "px", ("u_0", "v_0")),
            ("distortion", "1", LENSES[lens[i]]),
        )
        for j, name in enumerate(names)
    )


def _pair_of_lenses(lens: object) -> tuple[str, str]:
    pair = (lens, lens) if isinstance(lens, str) else lens
    if not isinstance(pair, tuple | list) or len(pair) != 2:
        raise ConfigurationError(f"lens: expected a name for each eye, got {lens!r:.80}")
    for name in pair:
        if name not in LENSES:
            raise ConfigurationError(f"lens: expected one of {', '.join(LENSES)}, got {name!r:.80}")
    return pair[0], pair[1]


def _pair_of_responses(given: Any) -> tuple[CameraResponse | None, CameraResponse | None]:
    left, right = given if isinstance(given, tuple) and len(given) == 2 else (given, given)
    return _response_or_none(left), _response_or_none(right)


def _response_or_none(given: Any) -> CameraResponse | None:
    return None if given is None else parse_response(given)


def _pair_of_sizes(size: ArrayLike) -> NDArray[np.int64]:
    if isinstance(size, np.ndarray) and size.dtype == np.int64 and not size.flags.writeable:
        return size  # already checked, from another head
    array = np.asarray(size)
    numbers = array.dtype.kind in "iuf" and array.shape in ((2,), (2, 2))
    if not numbers or not ((array >= 1) & (array == np.floor(array)) & (array < 1e9)).all():
        raise ConfigurationError(
            "size: expected the image's width and height in whole pixels, for both eyes or for "
            f"each, got {size!r:.80}"
        )
    pair = np.broadcast_to(array, (2, 2)).astype(np.int64)
    pair.flags.writeable = False
    return pair


def _coefficients(distortion: ArrayLike, lens: tuple[str, str]) -> FloatArray:
    """Check the coefficients, and pad or trim them to the columns that the lenses need."""
    values = np.asarray(distortion, dtype=np.float64)
    slots, count = padded_coefficient_count(lens), values.shape[-1] if values.ndim else 0
    if values.ndim < 2 or values.shape[-2] != 2 or not 4 <= count <= 8:
        raise ConfigurationError(
            f"distortion: expected shape (..., 2, {slots}), got {values.shape}"
        )
    for eye, name in enumerate(lens):
        if values[..., eye, len(LENSES[name]) :].any():
            raise ConfigurationError(
                f"distortion: expected {len(LENSES[name])} coefficients for the {EYE_NAMES[eye]} "
                f"eye's {name} lens and zeros beyond, got {values[..., eye, :].tolist()!r:.80}"
            )
    if count < slots:
        values = np.concatenate([values, np.zeros((*values.shape[:-1], slots - count))], axis=-1)
    return readonly_array(values[..., :slots])
