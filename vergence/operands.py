"""Check the shapes and types of arrays from outside, and make values for strict JSON of them."""

from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError

_FLOAT64: Final = np.dtype(np.float64)


def as_operand(name: str, value: ArrayLike, *core: int | str) -> NDArray[np.float64]:
    """Convert real numbers to an array, and check its shape.

    Args:
        name: name for messages.
        value: a number, or numbers in lists, tuples or an array.
        *core: sizes of the last axes; a name for an axis of any size.

    Returns:
        (..., *core) float64, `value` itself if it is such an array; it may hold nan and inf.

    Raises:
        ConfigurationError: the value has another shape, or an element is not a real number.
    """
    if (
        isinstance(value, np.ndarray)
        and value.dtype is _FLOAT64
        and value.shape[value.ndim - len(core) :] == core
    ):
        return value  # fast path for the most common case
    what = f"shape (..., {', '.join(map(str, core))})" if core else "real numbers"
    try:
        array: NDArray[Any] = np.asarray(value)
    except (TypeError, ValueError) as error:  # rows of different lengths
        raise ConfigurationError(
            f"{name}: expected {what}, got rows of different lengths"
        ) from error
    if array.dtype.kind not in "biuf":
        shown = " ".join(f"{value!r:.200}".split())  # the repr of an array has several lines
        raise ConfigurationError(f"{name}: expected real numbers, got {shown:.80}")
    own = array.shape[max(array.ndim - len(core), 0) :]
    if len(own) < len(core) or any(
        isinstance(size, int) and size != found for size, found in zip(core, own, strict=True)
    ):
        raise ConfigurationError(f"{name}: expected {what}, got {array.shape}")
    return array.astype(np.float64, copy=False)


def null_nonfinite_rows(values: ArrayLike | None) -> Any:
    """Convert to a number or nested lists of numbers, with None for rows that are not finite.

    Args:
        values: array of any shape; a row (the last axis) that holds nan or infinity becomes None as
            a whole, since a partial point is not usable. None stays None.
    """
    if values is None:
        return None
    array = np.asarray(values, np.float64)
    if array.ndim < 2:
        return array.tolist() if np.isfinite(array).all() else None
    return [null_nonfinite_rows(row) for row in array]


def null_nonfinite_elements(values: ArrayLike) -> Any:
    """Convert element by element, to a number or nested lists, with None for what is not finite."""
    array = np.asarray(values, np.float64)
    found = array.astype(object)
    found[~np.isfinite(array)] = None
    return found.tolist()
