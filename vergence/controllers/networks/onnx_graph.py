"""Check of network files: small ONNX graphs that process each row of a batch separately.

ONNX allows far more than a controller needs: loops, functions, code from shared libraries, tensors
in other files, and small graphs that request terabytes. So a graph is checked here before it
reaches the runtime. It is refused unless it has only the fields listed here, consists of the
operators of `vergence.controllers.networks.onnx_operators`, and has one input (batch, n) of
float32. Then every value is (batch, width) with a width known in advance, row i of the output
depends on row i of the input only, and the cost is bounded.
"""

from collections.abc import MutableSequence, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from vergence.controllers.networks.onnx_operators import (
    FLOAT,
    Value,
    infer_operator,
    read_constant,
)
from vergence.errors import BundleError, ConfigurationError, how_to_install

if TYPE_CHECKING:
    from onnx import ModelProto, OperatorSetIdProto, ValueInfoProto

MAX_NETWORK_BYTES: Final = 4 * 2**20
"""Largest size of a network file, bytes (chosen: safety against room for larger networks, as the
next four)."""
MAX_FIELDS: Final = 20_000
"""Largest number of fields in all messages of a file, a list of floats counted as one (chosen)."""
MAX_NODES: Final = 256
"""Largest number of operators (chosen)."""
MAX_WIDTH: Final = 4096
"""Largest number of entries in a row of any value (chosen)."""
MAX_PRODUCTS: Final = 4_000_000
"""Largest number of multiplications in matrix products per row (chosen)."""
OPSETS: Final = range(13, 26)
"""Versions of the default operator set in which the operators have the assumed meaning (physical:
the ONNX standard)."""

_COMMENT_FIELDS = {"doc_string", "metadata_props"}
FIELDS: Final[dict[str, set[str]]] = {
    "ModelProto": {
        *("ir_version", "opset_import", "graph", "producer_name", "producer_version", "domain"),
        *("model_version", *_COMMENT_FIELDS),
    },
    "OperatorSetIdProto": {"domain", "version"},
    "GraphProto": {
        "name",
        "node",
        "initializer",
        "input",
        "output",
        "value_info",
        *_COMMENT_FIELDS,
    },
    "NodeProto": {"name", "op_type", "domain", "input", "output", "attribute", *_COMMENT_FIELDS},
    "AttributeProto": {"name", "type", "f", "i", "s", "t", "doc_string"},
    "TensorProto": {
        *("name", "dims", "data_type", "data_location", "raw_data", "float_data", "int64_data"),
        *_COMMENT_FIELDS,
    },
    "ValueInfoProto": {"name", "type", *_COMMENT_FIELDS},
    "TypeProto": {"tensor_type", "denotation"},
    "Tensor": {"elem_type", "shape"},
    "TensorShapeProto": {"dim"},
    "Dimension": {"dim_value", "dim_param", "denotation"},
    "StringStringEntryProto": {"key", "value"},
}
"""Allowed fields of onnx.proto, by message.

All others are refused: functions, training information, sparse, quantised and external tensors,
graphs within attributes (control flow), types other than tensors, and whatever ONNX adds later.
"""


@dataclass(frozen=True)
class Network:
    """A checked ONNX network: the bytes of its file, names and sizes of input and output.

    Attributes:
        data: bytes of the file.
        input_name: name of the input.
        input_size: number of entries in a row of the input.
        output_name: name of the output.
        output_size: number of entries in a row of the output.
        one_row: True if it was exported for a batch of one, and must be run row by row.
        operators: names of its operators.
    """

    data: bytes
    input_name: str
    input_size: int
    output_name: str
    output_size: int
    one_row: bool
    operators: frozenset[str]


def read_network(data: bytes) -> Network:
    """Check a network file.

    Args:
        data: an ONNX model.

    Returns:
        The checked network.

    Raises:
        BundleError: it is no such graph; the message gives the reason.
    """
    if len(data) > MAX_NETWORK_BYTES:
        raise BundleError(
            f"network: expected at most {MAX_NETWORK_BYTES} bytes, got {len(data)} bytes"
        )
    try:
        from google.protobuf.message import DecodeError
        from onnx import ModelProto, checker
    except ImportError as error:
        raise ConfigurationError(
            f"learned controllers: expected onnx, got none: {how_to_install('learned')}"
        ) from error
    try:
        model = ModelProto.FromString(data)
    except DecodeError as error:
        raise BundleError(f"network: expected an ONNX model, got damage: {error!r:.200}") from error
    _check_fields(model)
    # refuse what other readers may interpret differently: unknown fields, single ones given twice
    model.DiscardUnknownFields()
    if model.SerializeToString(deterministic=True) != data:
        raise BundleError(
            "network: expected the bytes that ONNX itself writes, got unknown, repeated or "
            "reordered fields (onnx.save(onnx.load(path), path) puts them in order)"
        )
    network = _check_graph(data, model)
    try:
        checker.check_model(data)
    except (checker.ValidationError, ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise BundleError(
            f"network: expected a graph that ONNX allows, got {reason:.300}"
        ) from error
    return network


def _check_fields(model: "ModelProto") -> None:
    """Refuse fields that are not listed, text that is not UTF-8, and too many fields."""
    fields, messages = 0, [model]
    while messages:
        message = messages.pop()
        name = message.DESCRIPTOR.name
        for field, value in message.ListFields():
            allowed = FIELDS[name]
            if field.name not in allowed:
                raise BundleError(
                    f"network: {name}: expected the fields {', '.join(sorted(allowed))}, "
                    f"got {field.name}"
                )
            parts = value if isinstance(value, MutableSequence) else [value]
            fields += 1 if field.cpp_type == field.CPPTYPE_FLOAT else len(parts)
            if fields > MAX_FIELDS:
                raise BundleError(f"network: expected at most {MAX_FIELDS} fields, got more")
            if field.message_type is not None:
                messages.extend(parts)
            elif field.type == field.TYPE_STRING and any(isinstance(p, bytes) for p in parts):
                raise BundleError(f"network: {name}: expected {field.name} in UTF-8, got others")


def _check_graph(data: bytes, model: "ModelProto") -> Network:
    _check_opsets(model.opset_import)
    graph = model.graph
    if len(graph.node) > MAX_NODES:
        raise BundleError(f"network: expected at most {MAX_NODES} operators, got {len(graph.node)}")
    values: dict[str, Value] = {}
    source, width, batch = _port(graph.input, "input")
    _define(values, source, width)
    for tensor in graph.initializer:
        _define(values, tensor.name, read_constant(tensor))
    products = 0
    for node in graph.node:
        result, cost = infer_operator(node, values)
        products += cost
        if products > MAX_PRODUCTS:
            raise BundleError(f"network: expected at most {MAX_PRODUCTS} products, got more")
        if len(node.output) != 1:
            raise BundleError(
                f"network: expected one output of {node.op_type}, got {len(node.output)}"
            )
        _define(values, node.output[0], result)
    sink, stated, _batch = _port(graph.output, "output")
    outputs = values.get(sink)
    if not isinstance(outputs, int) or sink == source:
        raise BundleError(f"network: expected an output made from the input, got {sink!r:.60}")
    if stated != outputs:
        raise BundleError(f"network: expected an output of {outputs} numbers, got {stated}")
    operators = frozenset(node.op_type for node in graph.node)
    return Network(data, source, width, sink, outputs, batch == 1, operators)


def _check_opsets(opsets: "Sequence[OperatorSetIdProto]") -> None:
    stated = [(item.domain, item.version) for item in opsets]
    if len(stated) != 1 or stated[0][0] not in ("", "ai.onnx") or stated[0][1] not in OPSETS:
        raise BundleError(
            f"network: expected the default operator set alone, version {OPSETS[0]} to "
            f"{OPSETS[-1]}, got {stated!r:.120}"
        )


def _port(ports: "Sequence[ValueInfoProto]", what: str) -> tuple[str, int, int]:
    """Name, width and batch (0 for a free one) of the only input or output."""
    if len(ports) != 1:
        names = [port.name for port in ports]
        raise BundleError(f"network: expected one {what}, got {len(ports)}: {names!r:.120}")
    tensor = ports[0].type.tensor_type
    if tensor.elem_type != FLOAT:
        raise BundleError(
            f"network: expected an {what} of float32, got data type {tensor.elem_type}"
        )
    shape = [
        dim.dim_value if dim.HasField("dim_value") else dim.dim_param or "?"
        for dim in tensor.shape.dim
    ]
    batch, width = shape if len(shape) == 2 else ("?", "?")
    free = not isinstance(batch, int)
    if not isinstance(width, int) or not 0 < width <= MAX_WIDTH or not (free or batch == 1):
        raise BundleError(
            f"network: expected an {what} of shape (batch, n), n at most {MAX_WIDTH}, "
            f"got {shape!r:.120}"
        )
    return ports[0].name, width, 0 if free else 1


def _define(values: dict[str, Value], name: str, value: Value) -> None:
    if not name or name in values:
        raise BundleError(f"network: expected a new name for each value, got {name!r:.60}")
    if isinstance(value, int) and value > MAX_WIDTH:
        raise BundleError(
            f"network: expected rows of at most {MAX_WIDTH}, got {value}: {name!r:.60}"
        )
    values[name] = value
