"""What a network file may hold, and how everything else is refused."""

import contextlib
from pathlib import Path

import numpy as np
import onnx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from onnx import helper, numpy_helper

from tests.controllers.networks.graphs import model, perceptron, weights_of
from vergence.controllers.networks.onnx_graph import read_network
from vergence.controllers.networks.onnx_operators import OPERATORS
from vergence.controllers.networks.onnx_tensor import MAX_NETWORK_BYTES
from vergence.controllers.networks.runtime import Runtime
from vergence.errors import BundleError, VergenceError

node = helper.make_node
OUT = np.ones((27, 4), "f4")


def test_a_perceptron_is_what_numpy_computes():
    network = read_network(perceptron())
    assert (network.inputs, network.outputs) == (27, 4)
    x = np.random.default_rng(0).uniform(-1, 1, (100, 27)).astype("f4")
    h = x
    for matrix, offset in weights_of(27):
        h = np.tanh(h @ matrix + offset)
    # float32 sums of 27 terms
    assert Runtime(network)(x) == pytest.approx(h, abs=1e-6)


def test_every_allowed_kind_of_operator_runs_row_by_row():
    nodes = [
        node("Constant", [], ["half"], value=numpy_helper.from_array(np.float32(0.5), "half")),
        node("Sub", ["x", "mean"], ["a"]),
        node("Div", ["a", "std"], ["b"]),
        node("Clip", ["b", "low", "high"], ["c"]),
        node("Slice", ["c", "start", "end", "axis"], ["d"]),
        node("Concat", ["c", "d"], ["e"], axis=-1),
        node("LayerNormalization", ["e", "scale"], ["f"], axis=-1),
        node("MatMul", ["f", "W"], ["g"]),
        node("Add", ["g", "half"], ["h"]),
        node("Elu", ["h"], ["i"], alpha=0.7),
        node("Sigmoid", ["i"], ["j"]),
        node("Mul", ["i", "j"], ["k"]),
        node("Flatten", ["k"], ["l"]),
        node("Reshape", ["l", "shape"], ["m"]),
        node("Pow", ["m", "three"], ["y"]),
    ]
    weights = {
        "mean": np.full(27, 0.1, "f4"),
        "std": np.full((1, 27), 0.5, "f4"),
        "low": np.float32(-1),
        "high": np.float32(1),
        "start": np.array([2]),
        "end": np.array([7]),
        "axis": np.array([1]),
        "scale": np.ones(32, "f4"),
        "W": np.ones((32, 4), "f4"),
        "shape": np.array([-1, 4]),
        "three": np.float32(3),
    }
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


@pytest.mark.parametrize(
    ("nodes", "weights", "match"),
    [
        ([node("Softmax", ["x"], ["y"])], {}, "expected operators among .*'Softmax'"),
        ([node("Gemm", ["x", "W"], ["y"], domain="evil")], {"W": OUT}, "'evil.Gemm'"),
        ([node("Gemm", ["x", "W"], ["y"], transA=1)], {"W": OUT}, "transposed batch"),
        ([node("Gemm", ["x", "W"], ["y"])], {"W": OUT[:9]}, "expected rows of 9 numbers, got 27"),
        ([node("MatMul", ["x", "x"], ["y"])], {}, "constant as input 1"),
        ([node("Gemm", ["z", "W"], ["y"])], {"W": OUT}, "a value made before Gemm, got 'z'"),
        ([node("Add", ["W", "W"], ["y"])], {"W": np.ones(4, "f4")}, "value of the batch"),
        ([node("Add", ["x", "W"], ["y"])], {"W": np.ones((9, 27), "f4")}, "row of numbers"),
        ([node("Add", ["x", "W"], ["y"])], {"W": np.ones(9, "f4")}, "rows of one width"),
        ([node("Concat", ["x", "x"], ["y"], axis=0)], {}, "side by side, got axis 0"),
        ([node("Tanh", ["x"], ["y"])], {}, "expected an output of 27 numbers, got 4"),
        ([node("Tanh", ["x"], ["x"])], {}, "new name for each value, got 'x'"),
        ([node("Gemm", ["x", "W"], ["y"])], {"W": OUT * np.nan}, "finite weights in 'W'"),
        ([node("Gemm", ["x", "W"], ["y"])], {"W": OUT.astype("f8")}, "float32 or int64 in 'W'"),
        ([node("Gemm", ["x", "W"], ["y"], evil=1)], {"W": OUT}, "attributes .*evil"),
        ([], {"y": np.ones(4, "f4")}, "an output made from the input, got 'y'"),
    ],
)
def test_a_graph_that_is_not_row_by_row_of_known_operators_is_refused(nodes, weights, match):
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


def test_control_flow_functions_and_other_domains_are_refused():
    inner = helper.make_graph([], "inner", [], [])
    loop = node("Gemm", ["x", "W"], ["y"], body=inner)
    refused(model([loop], {"W": OUT}), "got field number 6")
    function = helper.make_function(
        "evil", "f", ["a"], ["b"], [node("Tanh", ["a"], ["b"])], [helper.make_opsetid("", 20)]
    )
    good = [node("Gemm", ["x", "W"], ["y"])]
    refused(model(good, {"W": OUT}, functions=[function]), "got field number 25")
    opsets = [helper.make_opsetid("", 20), helper.make_opsetid("evil", 1)]
    refused(model(good, {"W": OUT}, opset_imports=opsets), "default operator set alone.*evil")
    refused(model(good, {"W": OUT}, opset=11), "version 13 to 25")


def test_weights_in_other_files_are_refused():
    proto = model([node("Gemm", ["x", "W"], ["y"])], {"W": OUT})
    tensor = proto.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.external_data.add(key="location", value="/etc/passwd")
    tensor.data_location = onnx.TensorProto.EXTERNAL
    refused(proto, "got field number 13")
    tensor.ClearField("external_data")
    refused(proto, "weights inside the file")


def test_several_inputs_and_outputs_are_refused():
    proto = model([node("Gemm", ["x", "W"], ["y"])], {"W": OUT})
    proto.graph.input.append(helper.make_tensor_value_info("z", 1, ["batch", 3]))
    refused(proto, "expected one input, got 2")
    proto = model([node("Gemm", ["x", "W"], ["y"])], {"W": OUT})
    proto.graph.output.append(helper.make_tensor_value_info("x", 1, ["batch", 27]))
    refused(proto, "expected one output, got 2")
    proto = model([node("Gemm", ["x", "W"], ["y"])], {"W": OUT}, batch=7)
    refused(proto, r"shape \(batch, n\).*\[7, 27\]")


def test_a_large_file_is_refused_before_it_is_read():
    with pytest.raises(BundleError, match="expected at most 4194304 bytes, got 4194305"):
        read_network(b"\0" * (MAX_NETWORK_BYTES + 1))


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
    with contextlib.suppress(VergenceError):
        network = read_network(bytes(bad))
        # what passes, as another weight does, runs
        Runtime(network)(np.zeros((2, network.inputs), "f4"))


@given(st.binary(max_size=300))
def test_arbitrary_bytes_are_no_network(data):
    with pytest.raises(BundleError):
        read_network(data)


def test_the_documentation_names_the_operators():
    text = (Path(__file__).parents[3] / "docs" / "bundles.md").read_text("utf-8")
    (line,) = (line for line in text.splitlines() if line.startswith("- these operators: "))
    assert set(line.removeprefix("- these operators: ").rstrip(";").split(", ")) == OPERATORS
