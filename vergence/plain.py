"""Arrays as plain values for strict JSON, which has no nan and no infinity."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike


def plain(values: ArrayLike | None) -> Any:
    """A number or nested lists of numbers, None for what is not finite.

    Args:
        values: of any shape; a row (the last axis) with a number that is not finite becomes None as
            a whole: half a point is no point. None stays None.
    """
    if values is None:
        return None
    array = np.asarray(values, np.float64)
    if array.ndim < 2:
        return array.tolist() if np.isfinite(array).all() else None
    return [plain(row) for row in array]


def column(values: ArrayLike) -> list[float | None]:
    """Numbers of a list by themselves, each None where it is not finite."""
    array = np.asarray(values, np.float64)
    return [value if np.isfinite(value) else None for value in array.tolist()]
