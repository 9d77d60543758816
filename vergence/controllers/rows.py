"""Rows of numbers whose fields have names: flat float64 outside, records inside kernels.

A controller's state and its constants are rows of float64, which batch, broadcast and copy like
any array. A class with annotations says once what lies in such a row,

    class Joint:
        lag_s: float
        limits: Annotated[FloatArray, 2]
        eyes: Annotated[list[Eye], 2]   # a class of the same kind, twice

    JOINT: Final = row_layout(Joint)

and `joint: Joint = named(row, JOINT)` reads and writes the row by `joint.limits[1]`.
"""

from typing import Any, TypeAlias, get_args, get_origin, get_type_hints

import numpy as np

from vergence._jit import device
from vergence.models.parts import FloatArray

Layout: TypeAlias = np.dtype[np.void]
"""Where the fields of a row lie."""


def row_layout(fields: type) -> Layout:
    """The layout of a row, from the annotations of a class.

    Args:
        fields: a class whose annotations are `float`, `Annotated[FloatArray, *shape]`, another
            such class, or `Annotated[list[another], number]`.

    Returns:
        A dtype of float64 alone, in the order of the annotations.
    """
    layout: list[tuple[str, Any, tuple[int, ...]]] = []
    for name, hint in get_type_hints(fields, include_extras=True).items():
        shape: tuple[int, ...] = getattr(hint, "__metadata__", ())
        kind = hint.__origin__ if shape else hint
        if get_origin(kind) is list:
            (kind,) = get_args(kind)
        number = kind is float or get_origin(kind) is np.ndarray
        layout.append((name, np.float64 if number else row_layout(kind), shape))
    return np.dtype((np.record, layout))


def row_size(layout: Layout) -> int:
    """How many numbers a row has."""
    return layout.itemsize // 8


def make_row(layout: Layout, **values: Any) -> FloatArray:
    """A row of numbers from the values of its fields; those that are not given are zero.

    Args:
        layout: what `row_layout` returned.
        **values: numbers and arrays by field; tuples for fields that have fields themselves.

    Returns:
        (row_size,) float64.
    """
    row = np.zeros(1, dtype=layout)
    for name, value in values.items():
        row[name] = value
    return row.view(np.float64)


@device
def named(row: FloatArray, layout: Layout) -> Any:
    """A row by the names of its fields: the same numbers, not a copy.

    Args:
        row: (row_size,) C-contiguous.
        layout: what `row_layout` returned.
    """
    return row.view(layout)[0]
