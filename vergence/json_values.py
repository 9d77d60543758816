"""Convert arrays to plain values for strict JSON, which has no nan and no infinity."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike


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
