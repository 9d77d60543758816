"""Check the shapes and types of arrays from outside, and make values for strict JSON of them."""

from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError

_FLOAT64: Final = np.dtype(np.float64)


def as_operand(name: str, value: ArrayLike, *core: int | str) -> NDArray[np.float64]:
    """Convert numbers, which may be nan and inf, to float64 of a shape (..., *core).

    A name in `core` stands for an axis of any size. An array that fits is returned itself; for what
    does not fit, a `ConfigurationError` is raised.
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
    """Numbers in lists, with None for rows (the last axis) that hold nan or inf; None for None."""
    if values is None:
        return None
    array = np.asarray(values, np.float64)
    if array.ndim < 2:
        return array.tolist() if np.isfinite(array).all() else None
    return [null_nonfinite_rows(row) for row in array]


def null_nonfinite_elements(values: ArrayLike) -> Any:
    """A number, or numbers in lists, with None for nan and inf."""
    array = np.asarray(values, np.float64)
    found = array.astype(object)
    found[~np.isfinite(array)] = None
    return found.tolist()
