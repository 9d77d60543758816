"""ONNX at the border: users' own networks, run by onnxruntime, and bundles for other tools."""

import dataclasses
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from vergence.controllers.networks.bundle import (
    POLICY,
    Bundle,
    Floats,
    check_file,
    prefix_bundle_errors,
)
from vergence.errors import BundleError, ConfigurationError, how_to_install

if TYPE_CHECKING:
    from onnxruntime import InferenceSession


_EXTERNAL_FOLDER: Final = "session.model_external_initializers_file_folder_path"
"""Name of onnxruntime's option for the folder of external data (physical: onnxruntime)."""


class OnnxNetwork:
    """A network in an ONNX file with one input and one output, (batch, n) of float32.

    It runs on one thread of the CPU, row by row if it was exported for a batch of one. It is
    copied and pickled as the file's bytes.

    Args:
        path: the file.
        input_size: number of inputs that it must have.
        output_size: number of outputs.

    Raises:
        BundleError: it cannot be read, is no such network, or onnxruntime refuses it.
        ConfigurationError: onnxruntime is not installed.
    """

    def __init__(self, path: str | os.PathLike[str], input_size: int, output_size: int) -> None:
        with prefix_bundle_errors(str(path)):
            check_file(path)
            self._data, self._folder = Path(path).read_bytes(), str(Path(path).resolve().parent)
            self._open()
            sizes = {"input": input_size, "output": output_size}
            ports = (self._session.get_inputs(), self._session.get_outputs())
            for (what, size), found in zip(sizes.items(), ports, strict=True):
                shapes = [(one.type, one.shape) for one in found]
                if len(found) != 1 or found[0].type != "tensor(float)" or len(found[0].shape) != 2:
                    raise BundleError(
                        f"network: expected one {what} (batch, {size}) of float32, "
                        f"got {len(found)}: {shapes!r:.120}"
                    )
                if found[0].shape[1] != size:
                    raise BundleError(f"network: expected {size} {what}s, got {found[0].shape[1]}")
            self._one_row, self._output_size = ports[0][0].shape[0] == 1, output_size
            self._check_rows(input_size)

    def _check_rows(self, input_size: int) -> None:
        """Refuse a network that cannot run, or whose rows of a batch are not each by itself."""
        rows = np.random.default_rng(0).uniform(-1.0, 1.0, (3, input_size)).astype(np.float32)
        try:
            together, alone = self(rows), np.concatenate([self(row[None]) for row in rows])
        except Exception as error:  # the runtime's exceptions have no common base class
            raise BundleError(
                f"network: expected one that runs on any batch, got {_one_line(error)}"
            ) from error
        if together.shape != alone.shape or not np.allclose(together, alone, 1e-4, 1e-4, True):
            raise BundleError(
                "network: expected rows of a batch that do not depend on each other, nor on chance"
            )

    def __call__(self, inputs: NDArray[np.float32]) -> Floats:
        """Run the network: (..., input_size) to (..., output_size)."""
        rows = inputs.reshape(-1, inputs.shape[-1])
        if not len(rows):
            return np.zeros((*inputs.shape[:-1], self._output_size), dtype=np.float32)
        batches = rows[:, None] if self._one_row else [rows]
        name = self._session.get_inputs()[0].name
        out = np.concatenate([self._session.run(None, {name: batch})[0] for batch in batches])
        return out.reshape(*inputs.shape[:-1], out.shape[-1])

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_session"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._open()

    def _open(self) -> None:
        try:
            import onnxruntime
        except ImportError as error:
            raise ConfigurationError(
                f"an .onnx file: expected onnxruntime, got none: {how_to_install('learned')}"
            ) from error
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4
        # weights in files of their own lie beside the network's, not in the current folder
        options.add_session_config_entry(_EXTERNAL_FOLDER, self._folder)
        try:
            self._session: InferenceSession = onnxruntime.InferenceSession(
                self._data, sess_options=options, providers=["CPUExecutionProvider"]
            )
        # the runtime's exceptions have no common base class
        except Exception as error:
            raise BundleError(
                f"network: expected an ONNX model that can be run, got {_one_line(error)}"
            ) from error


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:300]


def bundle_as_onnx(bundle: Bundle) -> bytes:
    """Write a bundle's network as an ONNX graph, with the manifest in its metadata.

    The graph maps `inputs` (batch, n) to `actions` (batch, m), fractions of the manifest's
    `actions.limit`: velocities from -1 to 1 or gains from 0 to 1.

    Raises:
        ConfigurationError: onnx is not installed.
    """
    try:
        from onnx import TensorProto, helper, numpy_helper
    except ImportError as error:
        raise ConfigurationError(
            f"export onnx: expected onnx, got none: {how_to_install('learned')}"
        ) from error
    network = bundle.network
    constants: dict[str, NDArray[Any]] = {}
    nodes: list[Any] = []
    value = "inputs"

    def add(operator: str, *operands: NDArray[Any] | float, **attributes: Any) -> str:
        """Apply an operator to the value so far; return the new value's name."""
        names = [f"{operator}_{len(nodes)}_{k}" for k in range(len(operands))]
        for name, operand in zip(names, operands, strict=True):
            array = np.asarray(operand)
            constants[name] = array if array.dtype == np.int64 else array.astype(np.float32)
        out = f"value_{len(nodes)}"
        nodes.append(helper.make_node(operator, [value, *names], [out], **attributes))
        return out

    if network.normalisation is not None:
        mean, std, limit = network.normalisation
        value = add("Sub", mean)
        # the part of the mean that float32 does not hold matters where the deviation is tiny
        value = add("Sub", mean - mean.astype(np.float32))
        value = add("Div", std)
        value = add("Clip", -limit, limit)
    if network.joints > 1:
        value = add("Reshape", np.array([0, -1, network.joints]))
        value = add("Transpose", perm=[0, 2, 1])
    for k, (weights, bias) in enumerate(network.layers):
        value = add("MatMul", weights.T)
        value = add("Add", bias)
        if k == len(network.layers) - 1:
            value = add("Clip", -1.0, 1.0)
        elif network.activation == "silu":
            before = value
            nodes.append(helper.make_node("Sigmoid", [before], [f"{before}_sigmoid"]))
            value = f"{before}_silu"
            nodes.append(helper.make_node("Mul", [before, f"{before}_sigmoid"], [value]))
        else:
            value = add({"tanh": "Tanh", "relu": "Relu", "elu": "Elu"}[network.activation])
    if bundle.manifest.kind == POLICY:
        value = add("Pow", 3.0)
    else:
        value = add("Add", 1.0)
        value = add("Mul", 0.5)
        value = add("Pow", 2.0)
    value = add("Reshape", np.array([0, network.output_size]))
    nodes[-1].output[0] = "actions"
    graph = helper.make_graph(
        nodes,
        "network",
        [helper.make_tensor_value_info("inputs", TensorProto.FLOAT, ["batch", network.input_size])],
        [
            helper.make_tensor_value_info(
                "actions", TensorProto.FLOAT, ["batch", network.output_size]
            )
        ],
        [numpy_helper.from_array(array, name) for name, array in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, {"manifest": json.dumps(dataclasses.asdict(bundle.manifest))})
    return bytes(model.SerializeToString(deterministic=True))
