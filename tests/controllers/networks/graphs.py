"""Networks and bundles written by hand, with ONNX's own library."""

from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import helper, numpy_helper

from vergence import HeadModel, load_head
from vergence.controllers.networks.bundle import write_bundle
from vergence.controllers.networks.inputs import Inputs
from vergence.controllers.networks.manifest import Manifest

KINDS = {"gain-schedule": "predicted", "policy": "to_go"}
TRAINING = {"command": "vergence train policy --seed 3", "seed": 3}


def model(
    nodes: list[Any],
    weights: dict[str, Any] | None = None,
    size: int = 27,
    outputs: int = 4,
    *,
    batch: Any = "batch",
    opset: int = 20,
    **options: Any,
) -> onnx.ModelProto:
    """A graph from x, (batch, size), to y, (batch, outputs)."""
    graph = helper.make_graph(
        nodes,
        "network",
        [helper.make_tensor_value_info("x", onnx.TensorProto.FLOAT, [batch, size])],
        [helper.make_tensor_value_info("y", onnx.TensorProto.FLOAT, [batch, outputs])],
        [numpy_helper.from_array(np.asarray(w), name) for name, w in (weights or {}).items()],
    )
    options.setdefault("opset_imports", [helper.make_opsetid("", opset)])
    return helper.make_model(graph, ir_version=10, **options)


def perceptron(size: int = 27, seed: int = 0, outputs: int = 4, **options: Any) -> bytes:
    """tanh(tanh(x A + a) B + b)."""
    a, b = weights_of(size, seed, outputs)
    nodes = [
        helper.make_node("Gemm", ["x", "A", "a"], ["h"]), helper.make_node("Tanh", ["h"], ["t"]),
        helper.make_node("Gemm", ["t", "B", "b"], ["o"]), helper.make_node("Tanh", ["o"], ["y"]),
    ]  # fmt: skip
    weights = {"A": a[0], "a": a[1], "B": b[0], "b": b[1]}
    return model(nodes, weights, size, outputs, **options).SerializeToString()


def weights_of(size: int, seed: int = 0, outputs: int = 4) -> list[tuple[np.ndarray, np.ndarray]]:
    """The matrices and offsets of `perceptron`."""
    rng = np.random.default_rng(seed)
    shapes = [(size, 16), (16, outputs)]
    return [
        (rng.normal(0, 0.3, s).astype("f4"), rng.normal(0, 0.1, s[1]).astype("f4")) for s in shapes
    ]


def bundle_of(
    folder: Path, kind: str = "policy", head: HeadModel | None = None, **changes: Any
) -> Path:
    """A bundle of a perceptron, its manifest changed."""
    import dataclasses

    inputs = Inputs.of(KINDS[kind], load_head("simulated") if head is None else head)
    network = perceptron(inputs.size)
    manifest = Manifest.of(kind, inputs, network, TRAINING, {"settled_fraction": 1.0})
    path = folder / f"{kind}.vgp"
    write_bundle(path, dataclasses.replace(manifest, **changes), network, replace=True)
    return path
