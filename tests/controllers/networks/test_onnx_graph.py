"""Allowed content of a network file, and refusal of everything else."""

from collections.abc import MutableSequence
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from onnx import helper, numpy_helper

from tests.controllers.networks.graphs import model, perceptron, weights_of
from tests.naming import named
from vergence.controllers.networks.onnx_graph import FIELDS, MAX_NETWORK_BYTES, read_network
from vergence.controllers.networks.onnx_operators import OPERATORS
from vergence.controllers.networks.runtime import Runtime
from vergence.errors import BundleError

node = helper.make_node
OUT = np.ones((27, 4), "f4")


def test_a_perceptron_is_what_numpy_computes():
    network = read_network(perceptron())
    assert (network.input_size, network.output_size) == (27, 4)
    x = np.random.default_rng(0).uniform(-1, 1, (100, 27)).astype("f4")
    h = x
    for matrix, offset in weights_of(27):
        h = np.tanh(h @ matrix + offset)
    # float32 sums of 27 terms
    assert Runtime(network)(x) == pytest.approx(h, abs=1e-6)


def test_every_allowed_kind_of_operator_runs_row_by_row():
    nodes = [
        node("Constant", [], ["half"], value=numpy_helper.from_array(np.float32(0.5), "half")),
        node("Sub", ["x", "mean"], ["a"]), node("Div", ["a", "std"], ["b"]),
        node("Clip", ["b", "low", "high"], ["c"]),
        node("Slice", ["c", "start", "end", "axis"], ["d"]),
        node("Concat", ["c", "d"], ["e"], axis=-1),
        node("LayerNormalization", ["e", "scale"], ["f"], axis=-1),
        node("MatMul", ["f", "W"], ["g"]), node("Add", ["g", "half"], ["h"]),
        node("Elu", ["h"], ["i"], alpha=0.7), node("Sigmoid", ["i"], ["j"]),
        node("Mul", ["i", "j"], ["k"]), node("Flatten", ["k"], ["l"]),
        node("Reshape", ["l", "shape"], ["m"]), node("Pow", ["m", "three"], ["y"]),
    ]  # fmt: skip
    weights = {
        "mean": np.full(27, 0.1, "f4"), "std": np.full((1, 27), 0.5, "f4"),
        "low": np.float32(-1), "high": np.float32(1), "three": np.float32(3),
        "start": np.array([2]), "end": np.array([7]), "axis": np.array([1]),
        "scale": np.ones(32, "f4"), "W": np.ones((32, 4), "f4"), "shape": np.array([-1, 4]),
    }  # fmt: skip
    run = Runtime(read_network(model(nodes, weights).SerializeToString()))
    x = np.random.default_rng(0).uniform(-1, 1, (50, 27)).astype("f4")
    alone = np.concatenate([run(row[None]) for row in x])
    assert run(x) == pytest.approx(alone, abs=1e-6)


def test_a_network_exported_for_a_batch_of_one_runs_any_batch():
    single, free = (Runtime(read_network(perceptron(batch=b))) for b in (1, "batch"))
    x = np.random.default_rng(0).uniform(-1, 1, (3, 5, 27)).astype("f4")
    assert single(x) == pytest.approx(free(x), abs=1e-6)


def refused(proto: onnx.ModelProto, match: str) -> None:
    with pytest.raises(BundleError, match=match):
        read_network(proto.SerializeToString())


def test_a_graph_that_is_not_row_by_row_of_known_operators_is_refused():
    for nodes, weights, match in [
        ([node("Softmax", ["x"], ["y"])], {}, "expected operators among .*'Softmax'"),
        ([node("Gemm", ["x", "W"], ["y"], domain="evil")], {"W": OUT}, "'evil.Gemm'"),
        ([node("Gemm", ["x", "W"], ["y"], transA=1)], {"W": OUT}, "transposed batch"),
        ([node("Gemm", ["x", "W"], ["y"])], {"W": OUT[:9]}, "expected rows of 9 numbers, got 27"),
        ([node("MatMul", ["x", "x"], ["y"])], {}, "constant as input 1"),
        ([node("Gemm", ["z", "W"], ["y"])], {"W": OUT}, "a value made before Gemm, got 'z'"),
        ([node("Add", ["W", "W"], ["y"])], {"W": np.ones(4, "f4")}, "value of the batch"),
        ([node("Add", ["x", "W"], ["y"])], {"W": np.ones((9, 27), "f4")}, "row of numbers"),
        ([node("Concat", ["x", "x"], ["y"], axis=0)], {}, "side by side, got axis 0"),
        ([node("Tanh", ["x"], ["y"])], {}, "expected an output of 27 numbers, got 4"),
        ([node("Tanh", ["x"], ["x"])], {}, "new name for each value, got 'x'"),
        ([node("Gemm", ["x", "W"], ["y"])], {"W": OUT * np.nan}, "finite weights in 'W'"),
        ([node("Gemm", ["x", "W"], ["y"])], {"W": OUT.astype("f8")}, "float32 or int64 in 'W'"),
        ([node("Gemm", ["x", "W"], ["y"], evil=1)], {"W": OUT}, "attributes .*evil"),
        ([], {"y": np.ones(4, "f4")}, "an output made from the input, got 'y'"),
    ]:
        with named(nodes, weights, match):
            refused(model(nodes, weights), match)


def test_a_small_file_that_asks_for_terabytes_is_refused():
    nodes = [node("Concat", ["x", "x"], ["a0"], axis=1)]
    nodes += [node("Concat", [f"a{i}", f"a{i}"], [f"a{i + 1}"], axis=1) for i in range(40)]
    refused(model(nodes), "expected rows of at most 4096")


def test_a_small_file_that_takes_forever_is_refused():
    square = np.ones((512, 512), "f4")
    nodes = [node("Gemm", ["x", "W"], ["a0"])]
    nodes += [node("Gemm", [f"a{i}", "S"], [f"a{i + 1}"]) for i in range(40)]
    refused(model(nodes, {"W": np.ones((27, 512), "f4"), "S": square}), "products, got more")


def gemm(**options) -> onnx.ModelProto:
    """A network of one matrix."""
    return model([node("Gemm", ["x", "W"], ["y"])], {"W": OUT}, **options)


def test_other_sets_of_operators_are_refused():
    opsets = [helper.make_opsetid("", 20), helper.make_opsetid("evil", 1)]
    refused(gemm(opset_imports=opsets), "default operator set alone.*evil")
    refused(gemm(opset=11), "version 13 to 25")


def test_weights_in_other_files_are_refused(monkeypatch):
    monkeypatch.setattr("builtins.open", lambda *_args: pytest.fail("a file was opened"))
    proto = gemm()
    proto.graph.initializer[0].ClearField("raw_data")
    proto.graph.initializer[0].data_location = onnx.TensorProto.EXTERNAL
    refused(proto, "weights inside the file")


def test_several_inputs_and_outputs_are_refused():
    proto = gemm()
    proto.graph.input.append(helper.make_tensor_value_info("z", 1, ["batch", 3]))
    refused(proto, "expected one input, got 2")
    proto = gemm()
    proto.graph.output.append(helper.make_tensor_value_info("x", 1, ["batch", 27]))
    refused(proto, "expected one output, got 2")
    refused(gemm(batch=7), r"shape \(batch, n\).*\[7, 27\]")


def test_a_large_file_is_refused_before_it_is_read():
    with pytest.raises(BundleError, match="expected at most 4194304 bytes, got 4194305"):
        read_network(b"\0" * (MAX_NETWORK_BYTES + 1))


# The file: no more than is listed, and no other reading of it.


def submessage(number: int, content: bytes) -> bytes:
    """A field of protobuf that holds bytes, as it stands in a file."""
    size, parts = len(content), []
    while size > 127:
        parts.append(size & 127 | 128)
        size >>= 7
    return bytes([number << 3 | 2, *parts, size]) + content


def test_what_readers_of_protobuf_may_take_differently_is_refused():
    for field, match in [
        (b"\x98\x06\x01", "unknown, repeated or reordered"),  # number 99, which ONNX has not
        (b"\x08\x0a", "unknown, repeated or reordered"),  # a second ir_version, though the same
        (submessage(7, b""), "unknown, repeated or reordered"),  # a second graph, to be merged
        (submessage(3, b"\xff"), "producer_version in UTF-8"),
        (submessage(3, b"abc")[:-1], "got damage"),
        (b"\x0b" * 200, "got damage"),  # groups within groups
    ]:
        with named(field, match), pytest.raises(BundleError, match=match):
            read_network(perceptron() + field)


def test_graphs_nested_without_end_are_refused():
    data = b""
    for _ in range(200):
        data = submessage(1, submessage(5, submessage(6, data)))
    with pytest.raises(BundleError, match="got damage"):
        read_network(submessage(7, data))


def test_a_hundred_thousand_empty_messages_are_refused():
    for field in [submessage(1, b""), submessage(5, b""), submessage(11, b"")]:
        with named(field), pytest.raises(BundleError, match="expected at most 20000 fields"):
            read_network(submessage(7, field * 2**17))


def every_message(message: Any) -> list[Any]:
    """A message and all within it."""
    found = [message]
    for field, value in message.ListFields():
        if field.message_type is not None:
            for part in value if isinstance(value, MutableSequence) else [value]:
                found += every_message(part)
    return found


def change(message: Any, field: Any, value: Any) -> None:
    """Put a value into a field, or one more, or an empty message."""
    place = getattr(message, field.name)
    if isinstance(place, MutableSequence):
        place.append(value) if field.message_type is None else place.add()
    elif field.message_type is not None:
        place.SetInParent()
    else:
        setattr(message, field.name, value)


def rich() -> onnx.ModelProto:
    """A network that has every message a network may have."""
    tensor = numpy_helper.from_array(np.float32(0.5), "half")
    nodes = [node("Constant", [], ["half"], value=tensor), node("Mul", ["x", "half"], ["h"])]
    proto = model([*nodes, node("Gemm", ["h", "W"], ["y"], alpha=0.5)], {"W": OUT})
    proto.metadata_props.add(key="author", value="me")
    return proto


def test_every_field_that_is_not_listed_is_refused():
    read_network(rich().SerializeToString())
    tried = set()
    for index, found in enumerate(every_message(rich())):
        name = found.DESCRIPTOR.name
        for field in found.DESCRIPTOR.fields:
            if field.name not in FIELDS[name]:
                proto = rich()
                values = {field.TYPE_STRING: "a", field.TYPE_BYTES: b"a"}
                change(every_message(proto)[index], field, values.get(field.type, 1))
                refused(proto, f"^network: {name}: expected the fields .*, got {field.name}$")
                tried.add(f"{name}.{field.name}")
    assert {
        *("ModelProto.functions", "ModelProto.training_info", "GraphProto.sparse_initializer"),
        *("GraphProto.quantization_annotation", "AttributeProto.g", "AttributeProto.ref_attr_name"),
        *("TensorProto.external_data", "TensorProto.segment", "TypeProto.sequence_type"),
    } <= tried


def test_weights_of_another_size_than_stated_are_refused():
    for dims, fields, match in [
        ([27, 4], {"raw_data": b"\0" * 428}, "the 108 numbers of 'W' once, got 0 listed and 428"),
        ([27, 4], {"raw_data": b"\0" * 432, "float_data": [0.0]}, "once, got 1 listed and 432"),
        ([27, 4], {"float_data": [0.0] * 107}, "once, got 107 listed"),
        ([2**62, 4], {"raw_data": b""}, "the 18446744073709551616 numbers"),  # 0 modulo 2**64
        ([-27, -4], {"raw_data": b"\0" * 432}, r"2 dimensions in 'W', got \[-27, -4\]"),
        ([0, 4], {"raw_data": b""}, "2 dimensions"),
    ]:
        with named(dims, fields, match):
            proto = gemm()
            tensor = proto.graph.initializer[0]
            tensor.Clear()
            tensor.MergeFrom(onnx.TensorProto(name="W", data_type=1, dims=dims, **fields))
            refused(proto, match)


def test_attributes_that_come_twice_or_are_of_another_type_are_refused():
    proto = model([node("Gemm", ["x", "W"], ["y"], transA=0)], {"W": OUT})
    proto.graph.node[0].attribute.add().CopyFrom(helper.make_attribute("transA", 1))
    refused(proto, "each attribute once")
    proto = model([node("Gemm", ["x", "W"], ["y"], transA=0.0)], {"W": OUT})
    refused(proto, "expected a graph that ONNX allows, got .*transA")


def refused_or_runs(data: bytes) -> None:
    said = ""
    try:
        network = read_network(data)
        # what passes, as another weight does, runs
        Runtime(network)(np.zeros((2, network.input_size), "f4"))
    except BundleError as error:
        said = str(error)
    assert "\n" not in said
    assert len(said) < 1000


@given(data=st.data())
def test_damage_is_refused_and_nothing_else_is_raised(data):
    good = perceptron()
    if data.draw(st.booleans()):
        bad = bytearray(good)
        for _ in range(data.draw(st.integers(1, 4))):
            at = data.draw(st.integers(0, len(bad) - 1))
            bad[at] = data.draw(st.integers(0, 255))
    else:
        bad = bytearray(good[: data.draw(st.integers(0, len(good) - 1))])
    refused_or_runs(bytes(bad))


def test_the_documentation_names_the_operators():
    text = (Path(__file__).parents[3] / "docs" / "bundles.md").read_text("utf-8")
    (line,) = (line for line in text.splitlines() if line.startswith("- these operators: "))
    assert set(line.removeprefix("- these operators: ").rstrip(";").split(", ")) == OPERATORS
