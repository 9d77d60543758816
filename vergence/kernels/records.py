"""Records: groups of named numbers and arrays, the same for Python and for compiled code.

A record is a class with annotated fields. There are two kinds, by what they describe.

A *row* is what belongs to one head, such as a controller's state: a flat array of float64, which
batches, broadcasts, copies and compares as any array does, and is a record inside kernels. Its
class is never made, only named:

    class Joint:
        lag_s: float
        limits: Annotated[FloatArray, 2]
        eyes: Annotated[list[Eye], 2]   # a class of the same kind, twice

    JOINT: Final = row_layout(Joint)

after which `joint: Joint = record_view(row, JOINT)` reads and writes `joint.limits[1]`. In a loop
that writes arrays of a batch and reads many fields of a row, as a simulated step does of a trial's
conditions, a tuple of its numbers is a tenth faster: see `make_tuple_reader`.

A *group* is what belongs to a batch, such as a plant's ring buffers: a named tuple of arrays,
numbers and further groups. A compiled function takes it as an argument like any other; one that is
called in each period takes a table of it, made once by `make_table`, as the cost of a call is that
of its arguments, and `unpack_table` gives the group back with its names. A table's structured type
says how the group is nested, so compiled code is typed by it as by the group itself, and its bytes
say where the arrays are. Nothing is reference-counted: whoever makes a table keeps the group alive,
and makes another once an array has been replaced.
"""

import operator
from collections.abc import Callable
from importlib import import_module
from typing import Any, Final, TypeAlias, get_args, get_origin, get_type_hints

import numpy as np
from numba.core import cgutils, types
from numba.extending import lower_builtin, type_callable
from numba.np.arrayobj import load_item, populate_array
from numba.np.numpy_support import from_dtype
from numpy.typing import NDArray

from vergence.kernels.jit import inlined

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


def make_row(layout: Layout, **values: Any) -> NDArray[np.float64]:
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
def record_view(row: NDArray[np.float64], layout: Layout) -> Any:
    """View a row as a record with named fields, without copying.

    Args:
        row: (row_size,) C-contiguous.
        layout: layout from `row_layout`.
    """
    return row.view(layout)[0]


_WORD: Final = 8  # size of an address, a length and a stride, bytes (numerical)


def make_table(group: tuple[Any, ...]) -> NDArray[np.void]:
    """Describe arrays, numbers, booleans, None and nested tuples of these for `unpack_table`.

    The (1,) structured array is valid as long as the group's arrays exist. Read-only arrays are
    handed out as writable ones, so that compiled functions need no variants for them.
    """
    kind, value = _describe(group)
    return np.array([(value,)], dtype=[(_tuple_name("group", group), kind)])


def _tuple_name(place: object, group: tuple[Any, ...]) -> str:
    """Name of a tuple's field, with the class of a named one."""
    kind = type(group)
    return f"{place} tuple" + (
        f" {kind.__module__}:{kind.__qualname__}" if kind is not tuple else ""
    )


def _describe(group: tuple[Any, ...]) -> tuple[np.dtype[Any], tuple[Any, ...]]:
    fields: list[Any] = []
    values: list[Any] = []
    for place, part in enumerate(group):
        value: Any = 0 if part is None else part
        if isinstance(part, tuple):
            kind, value = _describe(part)
            fields.append((_tuple_name(place, part), kind))
        elif isinstance(part, np.ndarray):
            value = (part.ctypes.data, *part.shape, *part.strides)
            # numpy calls an array of one row contiguous whatever its stride, which would make
            # another type of the same array for one head
            dense = part.strides == np.empty_like(part, order="C", subok=False).strides
            layout = "C" if dense else "A"
            fields.append((f"{place} {layout} {part.dtype.str}", np.int64, (len(value),)))
        else:
            what = "none" if part is None else "number"
            fields.append((f"{place} {what}", np.asarray(value).dtype))
        values.append(value)
    return np.dtype(fields, align=True), tuple(values)


def unpack_table(table: NDArray[np.void]) -> Any:
    """Rebuild the group of a table inside a compiled function, with its names."""
    raise NotImplementedError


@type_callable(unpack_table)
def _type_group(context: Any) -> Any:
    return lambda table: _type_of(table.dtype).types[0]


@lower_builtin(unpack_table, types.Array)  # type: ignore[untyped-decorator]
def _load_group(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    (table,) = signature.args
    array = context.make_array(table)(context, builder, arguments[0])
    start = builder.bitcast(array.data, cgutils.voidptr_t)
    (field,) = table.dtype.fields.values()
    return _load(context, builder, field.type, signature.return_type, start)


def _type_of(record: Any, group: type | None = None) -> Any:
    parts: list[Any] = []
    for name, field in record.fields.items():
        what = name.split()[1:]
        if what[0] == "tuple":
            parts.append(_type_of(field.type, _class_named(what[1]) if what[1:] else None))
        elif what == ["none"]:
            parts.append(types.none)
        elif what == ["number"]:
            parts.append(field.type)
        else:
            layout, element = what
            dimensions = field.type.shape[0] // 2
            parts.append(types.Array(from_dtype(np.dtype(element)), dimensions, layout))
    return types.BaseTuple.from_types(tuple(parts), group)


def _class_named(name: str) -> Any:
    module, _, qualname = name.partition(":")
    return operator.attrgetter(qualname)(import_module(module))


def _load(context: Any, builder: Any, record: Any, result: Any, start: Any) -> Any:
    parts = []
    for part, field in zip(result.types, record.fields.values(), strict=True):
        at = cgutils.gep_inbounds(builder, start, field.offset)
        if isinstance(part, types.BaseTuple):
            parts.append(_load(context, builder, field.type, part, at))
        elif part is types.none:
            parts.append(context.get_dummy_value())
        elif isinstance(part, types.Array):
            parts.append(_load_array(context, builder, part, at))
        else:
            pointer = builder.bitcast(at, context.get_data_type(part).as_pointer())
            parts.append(context.unpack_value(builder, part, pointer))
    return context.make_tuple(builder, result, parts)


def _load_array(context: Any, builder: Any, kind: Any, at: Any) -> Any:
    def word(index: int) -> Any:
        place = cgutils.gep_inbounds(builder, at, _WORD * index)
        return builder.load(builder.bitcast(place, cgutils.intp_t.as_pointer()))

    array = context.make_array(kind)(context, builder)
    shape = [word(1 + axis) for axis in range(kind.ndim)]
    size = context.get_constant(types.intp, context.get_abi_sizeof(array.data.type.pointee))
    strides = [word(1 + kind.ndim + axis) for axis in range(kind.ndim)]
    if kind.layout == "C":  # LLVM knows more of these
        strides = [size]
        for length in reversed(shape[1:]):
            strides.insert(0, builder.mul(strides[0], length))
    data = builder.inttoptr(word(0), array.data.type)
    populate_array(array, data, shape, strides, itemsize=size, meminfo=None)
    return array._getvalue()


def make_tuple_reader(count: int) -> Callable[[NDArray[Any], int], tuple[Any, ...]]:
    """Make a function of an (n,) array and a first index >= 0 that returns elements as a tuple."""

    def run(row: NDArray[Any], first: int) -> tuple[Any, ...]:
        return tuple(row[first : first + count].tolist())

    @type_callable(run)
    def type_run(context: Any) -> Any:
        return lambda row, first: types.UniTuple(row.dtype, count)

    @lower_builtin(run, types.Array, types.Integer)  # type: ignore[untyped-decorator]
    def load_run(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array_type, first_type = signature.args
        array = context.make_array(array_type)(context, builder, arguments[0])
        start = context.cast(builder, arguments[1], first_type, types.intp)
        elements = []
        for i in range(count):
            place = builder.add(start, context.get_constant(types.intp, i))
            pointer = cgutils.get_item_pointer(context, builder, array_type, array, [place])
            elements.append(load_item(context, builder, array_type, pointer))
        return context.make_tuple(builder, signature.return_type, elements)

    return run
