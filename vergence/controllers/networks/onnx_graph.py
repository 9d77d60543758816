"""What a network file may be: a small ONNX graph that works on each row of a batch alone.

ONNX can say far more than a controller needs: loops, functions, code from shared libraries, tensors
in other files, and small graphs that ask for terabytes. So a graph is read here, before the runtime
sees it, and refused unless it is made of the operators of
`vergence.controllers.networks.onnx_operators`, on one input (batch, n) of float32:
every value is then (batch, width) with a width known now, row i of the output depends on row i of
the input alone, and what it costs has a bound.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from vergence.controllers.networks.onnx_operators import Value, apply_operator
from vergence.controllers.networks.onnx_schema import FLOAT, MODEL
from vergence.controllers.networks.onnx_tensor import MAX_NETWORK_BYTES, read_constant
from vergence.controllers.networks.protobuf import WireError, decode
from vergence.errors import BundleError

MAX_NODES: Final = 256
MAX_WIDTH: Final = 4096
"""Numbers a row of any value may have."""
MAX_PRODUCTS: Final = 4_000_000
"""Multiplications of matrix products per row."""
OPSETS: Final = range(13, 26)
"""Versions of the default operator set, in which the operators below mean what is meant here."""


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
        _define(values, tensor.get("name", ""), read_constant(tensor))
    products = 0
    for node in graph["node"]:
        result, cost = apply_operator(node, values)
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
