"""Packed rows with named fields: flat float64 arrays outside, records inside kernels.

A controller's state and constants are rows of float64, which batch, broadcast and copy like any
array. A class with annotations defines the contents of such a row,

    class Joint:
        lag_s: float
        limits: Annotated[FloatArray, 2]
        eyes: Annotated[list[Eye], 2]   # a class of the same kind, twice

    JOINT: Final = row_layout(Joint)

and `joint: Joint = named(row, JOINT)` reads and writes the row as `joint.limits[1]`.
"""

from typing import Any, TypeAlias, get_args, get_origin, get_type_hints

import numpy as np

from vergence.kernels import inlined
from vergence.models.parts import FloatArray

Layout: TypeAlias = np.dtype[np.void]
"""Offsets of the fields of a row."""


def row_layout(record_class: type) -> Layout:
    """Build the layout of a row from the annotations of a class.

    Args:
        record_class: a class whose annotations are `float`, `Annotated[FloatArray, *shape]`,
            another such class, or `Annotated[list[another], number]`.

    Returns:
        A dtype of float64 only, in the order of the annotations.
    """
    layout: list[tuple[str, Any, tuple[int, ...]]] = []
    for name, hint in get_type_hints(record_class, include_extras=True).items():
        shape: tuple[int, ...] = getattr(hint, "__metadata__", ())
        kind = hint.__origin__ if shape else hint
        if get_origin(kind) is list:
            (kind,) = get_args(kind)
        number = kind is float or get_origin(kind) is np.ndarray
        layout.append((name, np.float64 if number else row_layout(kind), shape))
    return np.dtype((np.record, layout))


def row_size(layout: Layout) -> int:
    """Length of a row, in numbers."""
    return layout.itemsize // 8


def make_row(layout: Layout, **values: Any) -> FloatArray:
    """Pack values of fields into a row; fields without a value are zero.

    Args:
        layout: layout from `row_layout`.
        **values: numbers and arrays by field; tuples for fields that have fields themselves.

    Returns:
        (row_size,) float64.
    """
    row = np.zeros(1, dtype=layout)
    for name, value in values.items():
        row[name] = value
    return row.view(np.float64)


@inlined
def record_view(row: FloatArray, layout: Layout) -> Any:
    """View a row as a record with named fields, without copying.

    Args:
        row: (row_size,) C-contiguous.
        layout: layout from `row_layout`.
    """
    return row.view(layout)[0]
