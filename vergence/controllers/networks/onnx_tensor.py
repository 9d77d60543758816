"""Constants in a network file: weights, and the whole numbers that some operators take."""

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from vergence.controllers.networks.onnx_schema import FLOAT, INT64
from vergence.errors import BundleError

MAX_NETWORK_BYTES: Final = 4 * 2**20
"""Size of a network file."""

Constant = NDArray[Any]


def read_constant(tensor: Mapping[str, Any]) -> Constant:
    """The array of a decoded `TensorProto`.

    Args:
        tensor: see `vergence.controllers.networks.onnx_schema`.

    Returns:
        float32 or int64, of at most two dimensions.

    Raises:
        BundleError: it is of another type or shape, lies in another file, or is not finite.
    """
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
