"""Arrays that come from outside: real numbers whose last axes have the sizes that are asked for."""

from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError

_FLOAT64: Final = np.dtype(np.float64)


def as_operand(name: str, value: ArrayLike, *core: int | str) -> NDArray[np.float64]:
    """Real numbers as an array.

    Args:
        name: what a message calls them.
        value: a number, or numbers in lists, tuples or an array.
        *core: sizes of the last axes; a name for one of any size.

    Returns:
        (..., *core) float64, the same array where it is one already; it may hold nan and inf.

    Raises:
        ConfigurationError: the value has another shape, or something in it is no real number.
    """
    if (
        isinstance(value, np.ndarray)
        and value.dtype is _FLOAT64
        and value.shape[value.ndim - len(core) :] == core
    ):
        return value  # what comes most often, at once
    what = f"shape (..., {', '.join(map(str, core))})" if core else "real numbers"
    try:
        array: NDArray[Any] = np.asarray(value)
    except (TypeError, ValueError) as error:  # rows of different lengths
        raise ConfigurationError(
            f"{name}: expected {what}, got rows of different lengths"
        ) from error
    if array.dtype.kind not in "biuf":
        shown = " ".join(f"{value!r:.200}".split())  # arrays are written in several lines
        raise ConfigurationError(f"{name}: expected real numbers, got {shown:.80}")
    own = array.shape[max(array.ndim - len(core), 0) :]
    if len(own) < len(core) or any(
        isinstance(size, int) and size != found for size, found in zip(core, own, strict=True)
    ):
        raise ConfigurationError(f"{name}: expected {what}, got {array.shape}")
    return array.astype(np.float64, copy=False)
