"""Networks and bundles made by hand, and ONNX files of their own."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from vergence import HeadModel, load_head
from vergence.controllers.networks.bundle import Manifest, Perceptron, write_bundle
from vergence.controllers.networks.inputs import Inputs

KINDS = {"gain-schedule": "predicted", "policy": "to_go"}
TRAINING = {"command": "vergence train policy --seed 3", "seed": 3}


def perceptron(size: int = 27, seed: int = 0, outputs: int = 4, **options: Any) -> Perceptron:
    """clip(tanh(x A + a) B + b)."""
    options = {"activation": "tanh", **options}
    joints = options.get("joints", 1)
    return Perceptron(layers=weights_of(size // joints, seed, outputs // joints), **options)


def weights_of(size: int, seed: int = 0, outputs: int = 4) -> tuple[tuple[Any, Any], ...]:
    """The matrices and offsets of `perceptron`."""
    rng = np.random.default_rng(seed)
    return tuple(
        (rng.normal(0, 0.3, s).astype("f4"), rng.normal(0, 0.1, s[0]).astype("f4"))
        for s in [(16, size), (outputs, 16)]
    )


def forward(x: np.ndarray) -> np.ndarray:
    """Output of `perceptron`."""
    (a, a0), (b, b0) = weights_of(x.shape[-1])
    return np.clip(np.tanh(x @ a.T + a0) @ b.T + b0, -1.0, 1.0)


def onnx_file(
    path: Path, size: int = 27, outputs: int = 4, batch: Any = "batch", *, weight: float = 9.0,
    last: str = "Identity", **options: Any,
) -> Path:  # fmt: skip
    """A file of weight times sum(x) for each output, and a last operator of one argument."""
    import onnx
    from onnx import helper, numpy_helper

    graph = helper.make_graph(
        [helper.make_node("MatMul", ["x", "W"], ["h"]), helper.make_node(last, ["h"], ["y"])],
        "network",
        [helper.make_tensor_value_info("x", onnx.TensorProto.FLOAT, [batch, size])],
        [helper.make_tensor_value_info("y", onnx.TensorProto.FLOAT, [batch, outputs])],
        [numpy_helper.from_array(np.full((size, outputs), weight, "f4"), "W")],
    )
    opsets = [helper.make_opsetid("", 17)]
    onnx.save(helper.make_model(graph, ir_version=8, opset_imports=opsets), path, **options)
    return path


def bundle_of(
    folder: Path, kind: str = "policy", head: HeadModel | None = None, **changes: Any
) -> Path:
    """A bundle of a perceptron, its manifest changed."""
    inputs = Inputs(KINDS[kind], load_head("simulated") if head is None else head)
    network = perceptron(inputs.size)
    manifest = Manifest.of(kind, inputs, network, TRAINING, {"settled_fraction": 1.0})
    path = folder / f"{kind}.vgp"
    write_bundle(path, dataclasses.replace(manifest, **changes), network, replace=True)
    return path
