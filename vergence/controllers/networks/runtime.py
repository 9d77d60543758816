"""Runs a checked network with onnxruntime on one thread of the CPU."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from vergence.controllers.networks.onnx_graph import Network
from vergence.errors import BundleError, ConfigurationError, how_to_install

if TYPE_CHECKING:
    import onnxruntime


class Runtime:
    """A network on one thread; it is copied and pickled as the network's bytes.

    Args:
        network: a checked network.

    Raises:
        ConfigurationError: onnxruntime is not installed.
        BundleError: the runtime refuses the network.
    """

    def __init__(self, network: Network) -> None:
        self.network = network
        self._session = _session(network)

    def __call__(self, inputs: NDArray[np.float32]) -> NDArray[np.float32]:
        """Run the network.

        Args:
            inputs: (..., n).

        Returns:
            (..., outputs).
        """
        rows = inputs.reshape(-1, self.network.input_size)
        if self.network.one_row and len(rows) != 1:
            out = np.concatenate([self._run(row[None]) for row in rows])
        else:
            out = self._run(rows)
        return out.reshape(*inputs.shape[:-1], self.network.output_size)

    def _run(self, rows: NDArray[np.float32]) -> NDArray[np.float32]:
        (out,) = self._session.run([self.network.output_name], {self.network.input_name: rows})
        return np.asarray(out)

    def __getstate__(self) -> Network:
        return self.network

    def __setstate__(self, network: Network) -> None:
        self.__init__(network)  # type: ignore[misc]


def _session(network: Network) -> "onnxruntime.InferenceSession":
    try:
        import onnxruntime
    except ImportError as error:
        raise ConfigurationError(
            f"learned controllers: expected onnxruntime, got none: {how_to_install('learned')}"
        ) from error
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    try:
        return onnxruntime.InferenceSession(
            network.data, sess_options=options, providers=["CPUExecutionProvider"]
        )
    # the runtime's exceptions have no common base class
    except Exception as error:
        reason = " ".join(str(error).split())
        raise BundleError(
            f"network: expected a graph that can be run, got {reason:.300}"
        ) from error
