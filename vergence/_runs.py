"""Runs of numbers inside kernels: many elements of an array read at the price of one.

Numba infers the type of each `row[i + 3]` by itself, and a tuple of seventeen of them costs as
much to compile as a page of arithmetic. A run is one operation. This module belongs to `_jit`,
whose cache goes stale with all modules that name it.
"""

from collections.abc import Callable
from typing import Any

from numba.core import cgutils, types
from numba.extending import intrinsic, overload
from numba.np.arrayobj import load_item
from numpy.typing import NDArray


def run_of(count: int) -> Callable[[NDArray[Any], int], tuple[Any, ...]]:
    """A function that reads so many elements of an array that lie in a row, as a tuple.

    Args:
        count: how many.

    Returns:
        Of an (n,) array and the index of the first element, which is not counted from the end.
    """

    def run(row: NDArray[Any], first: int) -> tuple[Any, ...]:
        return tuple(row[first : first + count].tolist())

    @intrinsic
    def load_run(typingctx: Any, row: Any, first: Any) -> Any:
        result = types.UniTuple(row.dtype, count)

        def load(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            array_type, first_type = signature.args
            array = context.make_array(array_type)(context, builder, arguments[0])
            start = context.cast(builder, arguments[1], first_type, types.intp)
            elements = []
            for i in range(count):
                place = builder.add(start, context.get_constant(types.intp, i))
                pointer = cgutils.get_item_pointer(context, builder, array_type, array, [place])
                elements.append(load_item(context, builder, array_type, pointer))
            return context.make_tuple(builder, result, elements)

        return result(row, first), load

    loader: Any = load_run
    overload(run)(lambda row, first: lambda row, first: loader(row, first))
    return run
