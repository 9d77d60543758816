"""Operators allowed in a network; each one processes every row separately.

An operator's rule refuses inputs and attributes that would mix rows of the batch, or give a value
that is not (batch, width) with a width known in advance. It returns that width and the number of
multiplications in matrix products per row.
"""

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from vergence.errors import BundleError

if TYPE_CHECKING:
    from onnx import NodeProto, TensorProto

Constant = NDArray[np.float32] | NDArray[np.int64]
"""Weights, or the integers that some operators take; at most two dimensions."""
Value = int | Constant
"""Width of a (batch, width) value, or a constant."""

FLOAT: Final = 1
"""Data type float32 of `TensorProto.DataType` (physical: the ONNX standard)."""
INT64: Final = 7
"""Data type int64 of `TensorProto.DataType` (physical: the ONNX standard)."""


def read_constant(tensor: "TensorProto") -> Constant:
    """Read the array of a tensor in a file.

    Args:
        tensor: tensor of a network file whose fields have been checked.

    Returns:
        The array.

    Raises:
        BundleError: it has another type or shape, lies in another file, or is not finite.
    """
    from onnx import numpy_helper

    name, dims = f"{tensor.name:.60}", list(tensor.dims)
    if tensor.data_location != tensor.DEFAULT:
        raise BundleError(f"network: expected weights inside the file, got others for {name!r}")
    if tensor.data_type not in (FLOAT, INT64):
        raise BundleError(
            f"network: expected float32 or int64 in {name!r}, got data type {tensor.data_type}"
        )
    if len(dims) > 2 or any(n <= 0 for n in dims):
        raise BundleError(f"network: expected at most 2 dimensions in {name!r}, got {dims[:8]}")
    listed = tensor.float_data if tensor.data_type == FLOAT else tensor.int64_data
    size = 4 if tensor.data_type == FLOAT else 8
    if len(listed) + len(tensor.raw_data) / size != math.prod(dims) or (listed and tensor.raw_data):
        raise BundleError(
            f"network: expected the {math.prod(dims)} numbers of {name!r} once, got "
            f"{len(listed)} listed and {len(tensor.raw_data)} bytes"
        )
    array = numpy_helper.to_array(tensor)
    if not np.isfinite(array).all():
        raise BundleError(f"network: expected finite weights in {name!r}, got some that are not")
    return array


class _Node:
    """An operator with resolved inputs; `take` checks the inputs and attributes its rule allows."""

    def __init__(self, node: "NodeProto", values: Mapping[str, Value]) -> None:
        self.operator = node.op_type
        self.attributes = {item.name: item for item in node.attribute}
        if len(self.attributes) != len(node.attribute):
            raise self.fail("each attribute once", f"{len(node.attribute)} with equal names")
        for name in node.input:
            if name and name not in values:
                raise BundleError(
                    f"network: expected a value made before {self.operator}, got {name!r:.60}"
                )
        self.inputs = [values.get(name) for name in node.input]

    def fail(self, expected: str, got: object) -> BundleError:
        return BundleError(f"network: {self.operator}: expected {expected}, got {got!s:.60}")

    def take(self, least: int, most: int, *attributes: str) -> None:
        """Raise an error for another number of inputs or for other attributes."""
        if not least <= len(self.inputs) <= most:
            raise self.fail(f"{least} to {most} inputs", len(self.inputs))
        unknown = sorted(set(self.attributes) - set(attributes))
        if unknown:
            raise self.fail(f"the attributes {list(attributes)}", unknown)

    def row(self, index: int = 0) -> int:
        """Width of an input that depends on the network's input."""
        value = self.inputs[index]
        if not isinstance(value, int):
            raise self.fail(f"a value of the batch as input {index}", "a constant or nothing")
        return value

    def constant(self, index: int, dtype: str = "f") -> Constant | None:
        """Constant input; None if it is omitted."""
        value = self.inputs[index] if index < len(self.inputs) else None
        if value is None:
            return None
        if isinstance(value, int) or value.dtype.kind != dtype:
            raise self.fail(f"a constant as input {index}", "a value of the batch or other numbers")
        return value

    def integer(self, name: str, default: int) -> int:
        """Integer attribute."""
        return self.attributes[name].i if name in self.attributes else default

    def width(self, index: int) -> int:
        """Number of entries of an input per row of the batch."""
        value = self.inputs[index]
        if isinstance(value, int):
            return value
        if value is None or value.dtype.kind != "f" or (value.ndim == 2 and value.shape[0] != 1):
            raise self.fail("a value of the batch or a row of numbers", "something else")
        return value.shape[-1] if value.ndim else 1


def _unary(node: _Node) -> tuple[int, int]:
    node.take(1, 1, "alpha", "beta", "gamma", "approximate")
    return node.row(), 0


def _binary(node: _Node) -> tuple[int, int]:
    node.take(2, 2)
    widths = node.width(0), node.width(1)
    if not any(isinstance(value, int) for value in node.inputs):
        raise node.fail("a value of the batch", "constants alone")
    if widths[0] != widths[1] and 1 not in widths:
        raise node.fail("rows of one width", widths)
    return max(widths), 0


def _clip(node: _Node) -> tuple[int, int]:
    node.take(1, 3)
    for bound in (node.constant(1), node.constant(2)):
        if bound is not None and bound.ndim:
            raise node.fail("scalar bounds", bound.shape)
    return node.row(), 0


def _matmul(node: _Node) -> tuple[int, int]:
    node.take(2, 2)
    return _product(node, transposed=False)


def _gemm(node: _Node) -> tuple[int, int]:
    node.take(2, 3, "alpha", "beta", "transA", "transB")
    if node.integer("transA", 0):
        raise node.fail("rows that stay apart", "a transposed batch")
    width, cost = _product(node, transposed=bool(node.integer("transB", 0)))
    bias = node.constant(2)
    if bias is not None and node.width(2) not in (1, width):
        raise node.fail(f"a bias of {width} numbers", bias.shape)
    return width, cost


def _product(node: _Node, *, transposed: bool) -> tuple[int, int]:
    weights = node.constant(1)
    if weights is None or weights.ndim != 2:
        raise node.fail("a constant matrix", "none" if weights is None else weights.shape)
    into, out = weights.shape[::-1] if transposed else weights.shape
    if node.row() != into:
        raise node.fail(f"rows of {into} numbers", node.row())
    return out, into * out


def _normalization(node: _Node) -> tuple[int, int]:
    node.take(2, 3, "axis", "epsilon", "stash_type")
    width = node.row()
    if node.integer("axis", -1) not in (-1, 1):
        raise node.fail("normalisation within a row", node.integer("axis", -1))
    for index in (1, 2):
        given = node.constant(index)
        if given is not None and given.shape != (width,):
            raise node.fail(f"{width} numbers", given.shape)
    return width, 0


def _concat(node: _Node) -> tuple[int, int]:
    node.take(1, 16, "axis")
    if node.integer("axis", 0) not in (-1, 1):
        raise node.fail("rows put side by side", f"axis {node.integer('axis', 0)}")
    return sum(node.row(index) for index in range(len(node.inputs))), 0


def _slice(node: _Node) -> tuple[int, int]:
    node.take(4, 5)
    width = node.row()
    given = [node.constant(index, "i") for index in range(1, 5)]
    parts = [None if part is None else part.tolist() for part in given]
    first, last, axis, step = parts
    ok = axis in ([1], [-1]) and step in (None, [1])
    if not ok or any(part is None or part.shape != (1,) for part in given[:2]):
        raise node.fail("one piece of each row", parts)
    left, right, _stride = slice(first[0], last[0]).indices(width)  # type: ignore[index]
    if not left < right:
        raise node.fail(f"some of {width} numbers", parts)
    return right - left, 0


def _same(node: _Node) -> tuple[int, int]:
    """Check an operator that other frameworks export as a no-op."""
    node.take(1, 2, "axis", "allowzero", "to")
    width = node.row()
    if node.operator == "Reshape":
        shape = node.constant(1, "i")
        if shape is None or shape.tolist() not in ([-1, width], [0, width], [0, -1]):
            raise node.fail(
                f"the shape (batch, {width})", "none" if shape is None else shape.tolist()
            )
    if node.operator == "Flatten" and node.integer("axis", 1) not in (1, -1):
        raise node.fail("axis 1", node.integer("axis", 1))
    if node.operator == "Cast" and node.integer("to", 0) != FLOAT:
        raise node.fail("float32", f"data type {node.integer('to', 0)}")
    return width, 0


_ROW_BY_ROW: Final[dict[str, Callable[[_Node], tuple[int, int]]]] = {
    **dict.fromkeys(("Abs", "Celu", "Elu", "Erf", "Exp", "Gelu", "HardSigmoid"), _unary),
    **dict.fromkeys(("HardSwish", "LeakyRelu", "Mish", "Neg", "Relu", "Selu"), _unary),
    **dict.fromkeys(("Sigmoid", "Softplus", "Softsign", "Sqrt", "Tanh"), _unary),
    **dict.fromkeys(("Add", "Div", "Max", "Min", "Mul", "Pow", "Sub"), _binary),
    **dict.fromkeys(("Cast", "Flatten", "Identity", "Reshape"), _same),
    "Clip": _clip,
    "Concat": _concat,
    "Gemm": _gemm,
    "LayerNormalization": _normalization,
    "MatMul": _matmul,
    "Slice": _slice,
}
OPERATORS: Final = frozenset({*_ROW_BY_ROW, "Constant"})
"""Allowed operators, all of the default domain."""


def infer_operator(node: "NodeProto", values: Mapping[str, Value]) -> tuple[Value, int]:
    """Check an operator and compute its result from the values so far.

    Args:
        node: operator of a network file whose fields have been checked.
        values: values that it may take, by name.

    Returns:
        Its result, and its multiplications per row.

    Raises:
        BundleError: it is not one of `OPERATORS`, or has inputs or attributes that are not allowed.
    """
    if node.domain not in ("", "ai.onnx") or node.op_type not in OPERATORS:
        name = f"{node.domain}.{node.op_type}" if node.domain else node.op_type
        raise BundleError(
            f"network: expected operators among {', '.join(sorted(OPERATORS))}, got {name!r:.60}"
        )
    asked = _Node(node, values)
    if node.op_type == "Constant":
        asked.take(0, 0, "value")
        if "value" not in asked.attributes:
            raise asked.fail("a tensor", "none")
        return read_constant(asked.attributes["value"].t), 0
    return _ROW_BY_ROW[node.op_type](asked)
