"""Camera response: the light that corresponds to each grey level."""

from functools import lru_cache
from math import isfinite
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from vergence.errors import ConfigurationError
from vergence.models.parts import FloatArray

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
