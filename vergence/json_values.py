"""Convert arrays to plain values for strict JSON, which has no nan and no infinity."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike


def json_value(values: ArrayLike | None) -> Any:
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
    return [json_value(row) for row in array]


def json_values(values: ArrayLike) -> list[float | None]:
    """Convert a list element by element, with None for numbers that are not finite."""
    array = np.asarray(values, np.float64)
    return [value if np.isfinite(value) else None for value in array.tolist()]
