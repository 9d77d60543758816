"""What a network file may be: a small ONNX graph that works on each row of a batch alone.

ONNX can say far more than a controller needs: loops, functions, code from shared libraries, tensors
in other files, and small graphs that ask for terabytes. So a graph is read here, before the runtime
sees it, and refused unless it is made of the operators below, on one input (batch, n) of float32:
every value is then (batch, width) with a width known now, row i of the output depends on row i of
the input alone, and what it costs has a bound.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from vergence.controllers.onnx_schema import FLOAT, INT64, MODEL
from vergence.controllers.protobuf import WireError, decode
from vergence.errors import BundleError

MAX_NETWORK_BYTES: Final = 4 * 2**20
"""Size of a network file."""
MAX_NODES: Final = 256
MAX_WIDTH: Final = 4096
"""Numbers a row of any value may have."""
MAX_PRODUCTS: Final = 4_000_000
"""Multiplications of matrix products per row."""
OPSETS: Final = range(13, 26)
"""Versions of the default operator set, in which the operators below mean what is meant here."""

Constant = NDArray[Any]
Value = int | Constant
"""The width of a (batch, width) value, or a constant."""


@dataclass(frozen=True)
class Network:
    """A graph that may be run.

    Attributes:
        data: the file.
        input: the input's name.
        inputs: numbers in a row of the input.
        output: the output's name.
        outputs: numbers in a row of the output.
        one_row: whether it was exported for a batch of one, and must be run row by row.
        operators: what it is made of.
    """

    data: bytes
    input: str
    inputs: int
    output: str
    outputs: int
    one_row: bool
    operators: frozenset[str]


def read_network(data: bytes) -> Network:
    """Check a network file.

    Args:
        data: an ONNX model.

    Returns:
        The network, fit to be run.

    Raises:
        BundleError: it is no such graph; the message says why.
    """
    if len(data) > MAX_NETWORK_BYTES:
        raise BundleError(
            f"network: expected at most {MAX_NETWORK_BYTES} bytes, got {len(data)} bytes"
        )
    try:
        return _check(data, decode(data, MODEL))
    except WireError as error:
        raise BundleError(f"network: not an ONNX graph that may run here: {error}") from error


def _check(data: bytes, model: Mapping[str, Any]) -> Network:
    _check_opsets(model["opset"])
    graph = model.get("graph")
    if graph is None:
        raise BundleError("network: expected a graph, got none")
    if len(graph["node"]) > MAX_NODES:
        raise BundleError(
            f"network: expected at most {MAX_NODES} operators, got {len(graph['node'])}"
        )
    values: dict[str, Value] = {}
    source, width, batch = _port(graph["input"], "input")
    _define(values, source, width)
    for tensor in graph["initializer"]:
        _define(values, tensor.get("name", ""), _constant(tensor))
    products = 0
    for node in graph["node"]:
        result, cost = _run(node, values)
        products += cost
        if products > MAX_PRODUCTS:
            raise BundleError(f"network: expected at most {MAX_PRODUCTS} products, got more")
        if len(node["output"]) != 1:
            raise BundleError(
                f"network: expected one output of {node['op_type']}, got {len(node['output'])}"
            )
        _define(values, node["output"][0], result)
    sink, stated, _batch = _port(graph["output"], "output")
    outputs = values.get(sink)
    if not isinstance(outputs, int) or sink == source:
        raise BundleError(f"network: expected an output made from the input, got {sink!r}")
    if stated != outputs:
        raise BundleError(f"network: expected an output of {outputs} numbers, got {stated}")
    operators = frozenset(node["op_type"] for node in graph["node"])
    return Network(data, source, width, sink, outputs, batch == 1, operators)


def _check_opsets(opsets: list[Mapping[str, Any]]) -> None:
    stated = [(item.get("domain", ""), item.get("version", 0)) for item in opsets]
    if len(stated) != 1 or stated[0][0] not in ("", "ai.onnx") or stated[0][1] not in OPSETS:
        raise BundleError(
            f"network: expected the default operator set alone, version {OPSETS[0]} to "
            f"{OPSETS[-1]}, got {stated}"
        )


def _port(ports: list[Mapping[str, Any]], what: str) -> tuple[str, int, int]:
    """Name, width and batch (0 where it is free) of the only input or output."""
    if len(ports) != 1:
        names = [port.get("name", "") for port in ports]
        raise BundleError(f"network: expected one {what}, got {len(ports)}: {names}")
    tensor = ports[0].get("type", {}).get("tensor", {})
    if tensor.get("elem_type") != FLOAT:
        raise BundleError(
            f"network: expected an {what} of float32, got data type {tensor.get('elem_type')}"
        )
    dims = tensor.get("shape", {}).get("dim", [])
    shape = [dim.get("value", dim.get("param") or "?") for dim in dims]
    batch, width = shape if len(shape) == 2 else ("?", "?")
    free = not isinstance(batch, int)
    if not isinstance(width, int) or not 0 < width <= MAX_WIDTH or not (free or batch == 1):
        raise BundleError(
            f"network: expected an {what} of shape (batch, n), n at most {MAX_WIDTH}, got {shape}"
        )
    return ports[0].get("name", ""), width, 0 if free else 1


def _define(values: dict[str, Value], name: str, value: Value) -> None:
    if not name or name in values:
        raise BundleError(f"network: expected a new name for each value, got {name!r}")
    if isinstance(value, int) and value > MAX_WIDTH:
        raise BundleError(f"network: expected rows of at most {MAX_WIDTH}, got {value} ({name})")
    values[name] = value


def _constant(tensor: Mapping[str, Any]) -> Constant:
    name = tensor.get("name", "")
    if tensor.get("data_location", 0) != 0:
        raise BundleError(f"network: expected weights inside the file, got others for {name!r}")
    dims, kind = tensor["dims"], tensor.get("data_type")
    if kind not in (FLOAT, INT64):
        raise BundleError(f"network: expected float32 or int64 in {name!r}, got data type {kind}")
    if len(dims) > 2 or any(not 0 < n <= MAX_NETWORK_BYTES for n in dims):
        raise BundleError(f"network: expected at most 2 dimensions in {name!r}, got {dims}")
    dtype = "<f4" if kind == FLOAT else "<i8"
    listed = tensor["float_data" if kind == FLOAT else "int64_data"]
    raw = tensor.get("raw_data", b"")
    if listed and raw:
        raise BundleError(f"network: expected the numbers of {name!r} once, got them twice")
    if len(raw) % np.dtype(dtype).itemsize:
        raise BundleError(f"network: expected whole numbers of {dtype} in {name!r}, got a rest")
    array = np.array(listed, dtype) if listed else np.frombuffer(raw, dtype)
    if array.size != math.prod(dims):
        raise BundleError(f"network: expected {dims} numbers in {name!r}, got {array.size}")
    if not np.isfinite(array).all():
        raise BundleError(f"network: expected finite weights in {name!r}, got some that are not")
    return array.reshape(dims)


class _Node:
    """An operator with its inputs looked up; what it takes must be asked for."""

    def __init__(self, node: Mapping[str, Any], values: Mapping[str, Value]) -> None:
        self.operator = node.get("op_type", "")
        self.attributes = {item.get("name", ""): item for item in node["attribute"]}
        self.inputs: list[Value | None] = []
        for name in node["input"]:
            if name and name not in values:
                raise BundleError(
                    f"network: expected a value made before {self.operator}, got {name!r}"
                )
            self.inputs.append(values[name] if name else None)

    def fail(self, expected: str, got: object) -> BundleError:
        return BundleError(f"network: {self.operator}: expected {expected}, got {got}")

    def take(self, least: int, most: int, *attributes: str) -> None:
        """Refuse another number of inputs and other attributes."""
        if not least <= len(self.inputs) <= most:
            raise self.fail(f"{least} to {most} inputs", len(self.inputs))
        unknown = sorted(set(self.attributes) - set(attributes))
        if unknown:
            raise self.fail(f"the attributes {list(attributes)}", unknown)

    def row(self, index: int = 0) -> int:
        """The width of an input that depends on the network's input."""
        value = self.inputs[index]
        if not isinstance(value, int):
            raise self.fail(f"a value of the batch as input {index}", "a constant or nothing")
        return value

    def constant(self, index: int, dtype: str = "f") -> Constant | None:
        """A constant input; None where it is left out."""
        value = self.inputs[index] if index < len(self.inputs) else None
        if value is None:
            return None
        if isinstance(value, int) or value.dtype.kind != dtype:
            raise self.fail(f"a constant as input {index}", "a value of the batch or other numbers")
        return value

    def integer(self, name: str, default: int) -> int:
        """An attribute that is a whole number."""
        return int(self.attributes[name].get("i", 0)) if name in self.attributes else default

    def width(self, index: int) -> int:
        """How many numbers an input has for each row of the batch."""
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
    parts = [None if part is None else part.ravel().tolist() for part in given]
    first, last, axis, step = parts
    ok = axis in ([1], [-1]) and step in (None, [1]) and first and last
    if not ok or len(first or ()) != 1 or len(last or ()) != 1:
        raise node.fail("one piece of each row", parts)
    left, right, _stride = slice(first[0], last[0]).indices(width)  # type: ignore[index]
    if not left < right:
        raise node.fail(f"some of {width} numbers", parts)
    return right - left, 0


def _same(node: _Node) -> tuple[int, int]:
    """Operators that are here only as other frameworks' way of doing nothing."""
    node.take(1, 2, "axis", "allowzero", "to")
    width = node.row()
    if node.operator == "Reshape":
        shape = node.constant(1, "i")
        if shape is None or shape.tolist() not in ([-1, width], [0, width], [0, -1]):
            raise node.fail(f"the shape (batch, {width})", shape)
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
"""The operators that a network may be made of, all of the default domain."""


def _run(node: Mapping[str, Any], values: Mapping[str, Value]) -> tuple[Value, int]:
    """What an operator makes, and its multiplications per row."""
    operator = node.get("op_type", "")
    domain = node.get("domain", "")
    if domain not in ("", "ai.onnx") or operator not in OPERATORS:
        name = f"{domain}.{operator}" if domain else operator
        raise BundleError(
            f"network: expected operators among {', '.join(sorted(OPERATORS))}, got {name!r}"
        )
    asked = _Node(node, values)
    if operator == "Constant":
        asked.take(0, 0, "value")
        tensor = asked.attributes.get("value", {}).get("t")
        if tensor is None:
            raise asked.fail("a tensor", "none")
        return _constant(tensor), 0
    return _ROW_BY_ROW[operator](asked)
