"""A camera's response: the light that each of its grey levels stands for."""

from functools import lru_cache
from math import isfinite
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from vergence.errors import ConfigurationError
from vergence.models.parts import FloatArray

Response = str | float | tuple[float, ...]
"""``"linear"``, ``"srgb"``, a gamma, or a table, see `parse_response`."""
LINEAR: Final = "linear"
SRGB: Final = "srgb"
EXPECTED: Final = (
    "'linear', 'srgb', a gamma from 0.2 to 5 such as 2.2 (light is the level's share to that "
    "power), or a table of the light at levels in equal steps, rising from 0 to 1"
)
"""A response, as messages say what one is."""
_GAMMAS: Final = (0.2, 5.0)
"""Powers of cameras and displays lie between 1 and 2.6; numerical bounds, far beyond."""
_LEVELS: Final = 256
_MOST_ENTRIES: Final = 65536


def parse_response(value: Any, name: str = "response") -> Response:
    """A response that a file, an option or a caller names.

    Args:
        value: ``"linear"``: levels in proportion to light. ``"srgb"``: as IEC 61966-2-1 says,
            which JPEG files, webcams and displays follow. A number g: light is the level's share
            of the greatest to the power of g. A table: at least two numbers, the light at levels
            in equal steps from 0 to the greatest, rising from 0 to 1. A text may hold the number,
            or those of the table with commas between them.
        name: what a message calls it.

    Raises:
        ConfigurationError: it is none of these.
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
        if not (isfinite(gamma) and _GAMMAS[0] <= gamma <= _GAMMAS[1]):
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


def default_response(*, colour: bool) -> Response:
    """The response of an image whose camera's nobody has stated.

    Cameras that give colours, and the files that people keep of them, follow sRGB nearly all;
    images in grey mostly come from industrial cameras, and from drawing them, without encoding.

    Args:
        colour: whether the image has colours: an array with three or four channels.
    """
    return SRGB if colour else LINEAR


def light_of(share: ArrayLike, response: Response) -> FloatArray:
    """The light that grey levels stand for.

    Args:
        share: levels, as shares of the greatest, 0 to 1.
        response: see `parse_response`.

    Returns:
        Light of the same shape, 0 to 1.
    """
    share = np.asarray(share, np.float64)
    if response == LINEAR:
        return share
    if response == SRGB:  # IEC 61966-2-1
        return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    if isinstance(response, tuple):
        return np.asarray(np.interp(share, np.linspace(0.0, 1.0, len(response)), response))
    return np.asarray(share ** float(response))


@lru_cache(maxsize=32)
def light_of_levels(response: Response) -> FloatArray:
    """The light that each grey level of 8 bits stands for.

    Args:
        response: see `parse_response`.

    Returns:
        (256,) from 0 to 255, read-only.
    """
    light = 255.0 * light_of(np.linspace(0.0, 1.0, _LEVELS), response)
    light.setflags(write=False)
    return light
