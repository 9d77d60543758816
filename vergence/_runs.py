"""Read several consecutive elements of an array in kernels, at the compile time of one.

Numba infers the type of each `row[i + 3]` separately, and a tuple of seventeen of them takes as
long to compile as a page of arithmetic. Reading a run of elements is a single operation. This
module names `_jit`, so that a change of it discards the cache of kernels.
"""

from collections.abc import Callable
from typing import Any

from numba.core import cgutils, types
from numba.extending import lower_builtin, type_callable
from numba.np.arrayobj import load_item
from numpy.typing import NDArray


def make_tuple_reader(count: int) -> Callable[[NDArray[Any], int], tuple[Any, ...]]:
    """Make a function that reads consecutive elements of an array as a tuple.

    Args:
        count: number of elements.

    Returns:
        Function of an (n,) array and the index of the first element, which must not be negative.
    """

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
