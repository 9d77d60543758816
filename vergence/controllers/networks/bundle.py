r"""Bundles: a trained network and all data needed to run it, in one safetensors file.

The tensors are the layers of a perceptron, the metadata has one entry, `manifest`, a table in JSON.
A file holds numbers and text alone: nothing in it can execute. See docs/bundles.md.
"""

import dataclasses
import hashlib
import json
import os
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from vergence.controllers.adaptive import GAIN_LIMIT, gain_names_of_head
from vergence.controllers.networks.inputs import Inputs
from vergence.envs.observation import ObservationLayout
from vergence.errors import BundleError, ConfigurationError, OtherHeadError, UnknownNameError
from vergence.files import write_atomic
from vergence.kernels import compiled
from vergence.models.head import HeadModel
from vergence.models.parts import JOINTS, SensorModel

Floats = NDArray[np.float32]
SUFFIX: Final = ".vgp"
MAX_FILE_BYTES: Final = 8 * 2**20
"""Largest size of a bundle's or network's file, bytes (chosen: safety against room for larger
networks)."""
FORMAT: Final = "vergence-bundle"
FORMAT_VERSION: Final = 2
"""Version of the bundle format (numerical)."""
GAIN_SCHEDULE: Final = "gain-schedule"
POLICY: Final = "policy"
_ROWS: Final = 128
"""Rows of a batch that are run at once (chosen: they stay in the cache)."""
_PRETRAINED: Final = resources.files("vergence.controllers") / "pretrained"
_ZIP_START: Final = b"PK"


@compiled
def _affine(x: Floats, weights: Floats, bias: Floats, out: Floats) -> None:
    """Fill out (m, rows) with weights (m, n) x (n, rows) + bias.

    The sums of a row have the same order whatever the number of rows, so one head is to the bit a
    row of a batch; products by BLAS are not.
    """
    count = weights.shape[1]
    for o in range(weights.shape[0]):
        row = out[o]
        for r in range(row.size):
            row[r] = bias[o]
        whole = count - count % 4
        for i in range(0, whole, 4):  # four at a time, so that memory is written less often
            a, b, c, d = weights[o, i], weights[o, i + 1], weights[o, i + 2], weights[o, i + 3]
            xa, xb, xc, xd = x[i], x[i + 1], x[i + 2], x[i + 3]
            for r in range(row.size):
                row[r] = row[r] + a * xa[r] + b * xb[r] + c * xc[r] + d * xd[r]
        for i in range(whole, count):
            for r in range(row.size):
                row[r] += weights[o, i] * x[i, r]


@compiled
def _tanh(x: Floats) -> None:
    """Replace x (m, rows) by tanh x: a continued fraction at half the angle, within 2e-7."""
    limit = np.float32(9.0)  # beyond it, float32 is 1
    for o in range(x.shape[0]):
        row = x[o]
        for r in range(row.size):
            half = np.float32(0.5) * min(max(row[r], -limit), limit)
            s = half * half
            p = np.float32(378.0) + s
            p = half * (np.float32(135135.0) + s * (np.float32(17325.0) + s * p))
            q = np.float32(3150.0) + s * np.float32(28.0)
            q = np.float32(135135.0) + s * (np.float32(62370.0) + s * q)
            row[r] = np.float32(2.0) * p * q / (q * q + p * p)


def _relu(x: Floats) -> None:
    np.maximum(x, 0.0, out=x)


def _elu(x: Floats) -> None:
    np.copyto(x, np.expm1(np.minimum(x, 0.0)), where=x < 0.0)


def _silu(x: Floats) -> None:
    with np.errstate(over="ignore"):
        x /= 1.0 + np.exp(-x)


ACTIVATIONS: Final[dict[str, Callable[[Floats], None]]] = {
    "tanh": _tanh,
    "relu": _relu,
    "elu": _elu,
    "silu": _silu,
}
"""Activations of hidden layers: each changes its argument in place."""


@dataclass(frozen=True, kw_only=True)
class Perceptron:
    """A network: layers h = f(W h + b), the last one without f, limited to [-1, 1].

    One network can serve several joints in turn: entries j, j + joints, j + 2 joints, ... of the
    inputs are those of joint j, and its single output is that joint's.
    """

    layers: tuple[tuple[Floats, Floats], ...]
    """Weights (outputs, inputs) and bias (outputs,) of each layer."""
    activation: str
    """One of `ACTIVATIONS`."""
    joints: int = 1
    """Number of joints that the network serves in turn."""
    normalisation: tuple[NDArray[np.float64], NDArray[np.float64], float] | None = None
    """Mean and standard deviation (size,) of the inputs, and the limit of normalised ones."""

    @property
    def input_size(self) -> int:
        """Number of inputs."""
        return int(self.joints * self.layers[0][0].shape[1])

    @property
    def output_size(self) -> int:
        """Number of outputs."""
        return int(self.joints * self.layers[-1][0].shape[0])

    def __call__(self, inputs: Floats) -> Floats:
        """Run the network on inputs (..., input_size); return outputs (..., output_size)."""
        x = inputs
        if self.normalisation is not None:
            mean, std, limit = self.normalisation
            x = np.clip((x - mean) / std, -limit, limit).astype(np.float32)
        x = x.reshape(-1, self.input_size)
        blocks = [self._run(x[k : k + _ROWS]) for k in range(0, max(len(x), 1), _ROWS)]
        out = blocks[0] if len(blocks) == 1 else np.concatenate(blocks)
        return out.reshape(*inputs.shape[:-1], self.output_size)

    def _run(self, rows: Floats) -> Floats:
        """Run the layers on rows (n, input_size), the joints of all rows side by side."""
        count, channels = len(rows), self.layers[0][0].shape[1]
        x = np.ascontiguousarray(rows.T).reshape(channels, self.joints * count)
        for place, (weights, bias) in enumerate(self.layers):
            out = np.empty((len(weights), x.shape[1]), dtype=np.float32)
            _affine(x, weights, bias, out)
            if place < len(self.layers) - 1:
                ACTIVATIONS[self.activation](out)
            x = out
        x = np.maximum(np.minimum(x, 1.0, out=x), -1.0, out=x)
        return np.ascontiguousarray(x.reshape(self.output_size, count).T)

    def tensors(self) -> dict[str, NDArray[Any]]:
        """The numbers of the network by their names in a bundle."""
        named: dict[str, NDArray[Any]] = {}
        for k, (weights, bias) in enumerate(self.layers):
            named[f"layers.{k}.weight"], named[f"layers.{k}.bias"] = weights, bias
        if self.normalisation is not None:
            named["inputs.mean"], named["inputs.std"], _limit = self.normalisation
        return named

    def settings(self) -> dict[str, Any]:
        """All of the network but its numbers, for a manifest."""
        limit = None if self.normalisation is None else self.normalisation[2]
        return {"activation": self.activation, "joints": self.joints, "clip_inputs": limit}

    @classmethod
    def of(cls, tensors: Mapping[str, NDArray[Any]], settings: Mapping[str, Any]) -> "Perceptron":
        """Make a network of `tensors` and `settings`, or raise a `BundleError`."""
        count = sum(bool(re.fullmatch(r"layers\.\d+\.weight", name)) for name in tensors)
        limit, joints = settings.get("clip_inputs"), settings.get("joints")
        names = [f"layers.{k}.{part}" for k in range(count) for part in ("weight", "bias")]
        names += [] if limit is None else ["inputs.mean", "inputs.std"]
        if limit is not None and not (type(limit) is float and 0.0 < limit < np.inf):
            raise BundleError(
                f"network: clip_inputs: expected a number with a point above 0 or null, "
                f"got {limit!r:.60}"
            )
        if not count or sorted(names) != sorted(tensors):
            raise BundleError(
                f"network: expected the tensors {', '.join(names)}, got {sorted(tensors)!r:.200}"
            )
        if settings.get("activation") not in list(ACTIVATIONS):
            raise UnknownNameError("activation", settings.get("activation"), list(ACTIVATIONS))
        if not isinstance(joints, int) or not 0 < joints <= len(JOINTS):
            raise BundleError(f"network: joints: expected 1 to {len(JOINTS)}, got {joints!r}")
        width = tensors["layers.0.weight"].shape[-1] if tensors["layers.0.weight"].ndim == 2 else 0
        size = joints * width
        for name in names:
            tensor = tensors[name]
            layer, _, part = name.rpartition(".")
            if layer == "inputs":
                shape: tuple[int, ...] = (size,)
            elif part == "weight":
                shape = (tensor.shape[0] if tensor.ndim else 0, width)
                width = shape[0]
            else:
                shape = (width,)
            kind = np.float64 if layer == "inputs" else np.float32
            if tensor.shape != shape or not tensor.size or tensor.dtype != kind:
                raise BundleError(
                    f"network: {name}: expected {kind.__name__} of shape {shape}, "
                    f"got {tensor.dtype} of shape {tensor.shape}"
                )
            if not np.isfinite(tensor).all() or (part == "std" and tensor.min() <= 0.0):
                what = "numbers above 0" if part == "std" else "finite numbers"
                raise BundleError(f"network: {name}: expected {what}, got others")
        layers = tuple(
            (tensors[f"layers.{k}.weight"], tensors[f"layers.{k}.bias"]) for k in range(count)
        )
        normalisation = None
        if limit is not None:
            normalisation = (tensors["inputs.mean"], tensors["inputs.std"], limit)
        return cls(
            layers=layers,
            activation=settings["activation"],
            joints=joints,
            normalisation=normalisation,
        )


@dataclass(frozen=True, kw_only=True)
class Manifest:
    """The manifest of a bundle; every field consists of plain numbers, text, lists and tables."""

    kind: str
    """`gain-schedule` (the network chooses gains) or `policy` (joint velocities)."""
    head: Mapping[str, Any]
    """Name and digest (SHA-256) of the head used in training, and `fits`, the digest of that head
    without its sensor; the network also fits any head with that digest."""
    period_s: float
    """Control period, s."""
    joints: list[str]
    """Joint order of the package."""
    layout: Mapping[str, Any]
    """Layout of observations, `ObservationLayout.to_dict()`."""
    inputs: Mapping[str, Any]
    """Inputs of the network, `Inputs.to_dict()`."""
    actions: Mapping[str, Any]
    """`names`, `unit` and `limit` of the actions, and `value`, the equation from an output y."""
    network: Mapping[str, Any]
    """`Perceptron.settings()`."""
    training: Mapping[str, Any]
    """Record of the training: `command`, `seed`, `scenario`, `steps`, `versions` and more."""
    metrics: Mapping[str, Any]
    """Performance measured by the training run."""

    @classmethod
    def of(
        cls,
        kind: str,
        inputs: Inputs,
        network: Perceptron,
        training: Mapping[str, Any],
        metrics: Mapping[str, Any],
    ) -> "Manifest":
        """Make the manifest of a network; `training` and `metrics` hold plain values."""
        head, layout = inputs.head, inputs.layout
        return cls(
            kind=kind,
            head={"name": head.name, "digest": head.digest, "fits": sensorless_digest(head)},
            period_s=layout.period_s,
            joints=list(JOINTS),
            layout=layout.to_dict(),
            inputs=inputs.to_dict(),
            actions=describe_actions(kind, head, layout),
            network=network.settings(),
            training=dict(training),
            metrics=dict(metrics),
        )

    @property
    def fits(self) -> str:
        """Name of the head that it fits, and the beginning of its digest, for messages."""
        return f"{self.head.get('name')} ({str(self.head.get('digest'))[:12]})"

    def is_for(self, head: HeadModel) -> bool:
        """True if a head equals the one of the manifest, except for its sensor."""
        return self.head.get("digest") == head.digest or self.head.get("fits") == sensorless_digest(
            head
        )

    def check_fits(
        self, head: HeadModel, layout: ObservationLayout, allow_other_head: bool = False
    ) -> Inputs:
        """Raise an error for a head or a layout that the network was not trained for.

        Args:
            head: the model of the head to control.
            layout: the layout of observations and actions.
            allow_other_head: True if the head's geometry may differ, as with randomised models; the
                meaning of the observation may not.

        Returns:
            The inputs of the network, for this head.

        Raises:
            BundleError: something differs; the message names the first difference.
        """
        expected = {
            "period_s": layout.period_s,
            "joints": list(JOINTS),
            "layout": layout.to_dict(),
            "actions": describe_actions(self.kind, head, layout),
        }
        differences = (
            _first_difference(value, getattr(self, key), key) for key, value in expected.items()
        )
        difference = next((found for found in differences if found is not None), None)
        detail = "; allow_other_head runs it nevertheless"
        if difference is not None:
            path, wanted, got = difference
            detail = f"{path}: expected {wanted!r} for head {head.name!r}, got {got!r}"
        if not self.is_for(head) and not allow_other_head:
            joined = f": {detail}" if difference is not None else detail
            raise OtherHeadError(
                f"head: expected a bundle for {head.name} ({head.digest[:12]}), got one for "
                f"{self.fits} alone{joined}"
            )
        if difference is not None:
            raise OtherHeadError(f"{detail}, made for head {self.fits}")
        try:
            return Inputs.from_dict(dict(self.inputs), head, layout)
        except (ConfigurationError, UnknownNameError) as error:
            raise BundleError(str(error)) from error


@dataclass(frozen=True)
class Bundle:
    """A bundle that has been read and checked."""

    source: str
    """Its file, for messages."""
    manifest: Manifest
    network: Perceptron


def read_bundle(path: str | os.PathLike[str]) -> Bundle:
    """Read and check a bundle, a `.vgp` file.

    Raises:
        BundleError: it cannot be read, is too large, damaged, or of another format.
    """
    with prefix_bundle_errors(str(path)):
        if _start_of(path) == _ZIP_START:
            raise BundleError(
                "expected a safetensors file, got a zip, an earlier format: `vergence export "
                "bundle RUN` writes its run's network anew"
            )
        try:
            with safe_open(path, framework="numpy") as file:
                metadata = file.metadata() or {}
                tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        # a damaged header may also name a type that NumPy lacks, or text that is not UTF-8
        except (SafetensorError, OSError, TypeError, ValueError, AttributeError) as error:
            raise BundleError(
                f"expected a safetensors file, got {' '.join(str(error).split()):.120}"
            ) from error
        manifest = _parse(metadata.get("manifest", ""), tensors)
        return Bundle(str(path), manifest, Perceptron.of(tensors, manifest.network))


@contextmanager
def prefix_bundle_errors(source: str) -> Iterator[None]:
    """Prefix the message of a `BundleError` with the origin of the bytes."""
    try:
        yield
    except (BundleError, UnknownNameError) as error:
        kind = type(error) if isinstance(error, BundleError) else BundleError
        raise kind(f"{source}: {error}") from error


def write_bundle(
    path: str | os.PathLike[str], manifest: Manifest, network: Perceptron, replace: bool = False
) -> None:
    """Write a bundle, as a whole or not at all; equal content gives equal files.

    Raises:
        BundleError: the bundle would be refused when read, or the file cannot be written.
    """
    target = Path(path)
    tensors = network.tensors()
    content = {"format": FORMAT, "version": FORMAT_VERSION, **dataclasses.asdict(manifest)}
    try:
        content["sha256"] = _digest(content, tensors)
        text = json.dumps(content, sort_keys=True, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise BundleError(f"manifest: expected plain finite values, got {error}") from error
    Perceptron.of(tensors, network.settings())
    data = save(tensors, {"manifest": text})
    if len(data) > MAX_FILE_BYTES:
        raise BundleError(f"{target}: expected at most {MAX_FILE_BYTES} bytes, got {len(data)}")
    if target.exists() and not replace:
        raise BundleError(f"{target}: expected no file of that name, got one")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(target, data)
    except OSError as error:
        raise BundleError(f"{target}: cannot be written: {error.strerror}") from error


def pretrained_bundles() -> dict[str, Path]:
    """Return the paths of the bundles that ship with the package, by name."""
    folder = Path(str(_PRETRAINED))
    return {path.stem: path for path in sorted(folder.glob(f"*{SUFFIX}"))}


def find_bundle(name: str | os.PathLike[str]) -> Bundle:
    """Read a bundle from a file `*.vgp`, or a shipped one by name.

    Raises:
        BundleError: it cannot be read or is damaged.
        ConfigurationError: no such bundle is shipped.
    """
    if not isinstance(name, str | os.PathLike):
        raise ConfigurationError(
            f"bundle: expected a file's path or the name of a shipped bundle, got {name!r:.80}"
        )
    if Path(name).suffix == SUFFIX:
        return read_bundle(name)
    shipped = pretrained_bundles()
    if name not in shipped:
        raise ConfigurationError(
            f"bundle: expected a file named *{SUFFIX} or one of the shipped "
            f"{', '.join(shipped) or '(there are none)'}, got {os.fspath(name)!r}"
        )
    return read_bundle(shipped[os.fspath(name)])


def check_file(path: str | os.PathLike[str]) -> None:
    """Raise a `BundleError` for what is no file, or larger than `MAX_FILE_BYTES`."""
    try:
        if not Path(path).is_file():  # excludes folders and endless devices
            raise BundleError("expected a file, got none of that name")
        size = Path(path).stat().st_size
    except OSError as error:  # such as a name too long
        raise BundleError(f"expected a file, got {error.strerror}") from error
    if size > MAX_FILE_BYTES:
        raise BundleError(f"expected at most {MAX_FILE_BYTES} bytes, got {size}")


def _start_of(path: str | os.PathLike[str]) -> bytes:
    check_file(path)
    try:
        with open(path, "rb") as file:
            return file.read(len(_ZIP_START))
    except OSError as error:
        raise BundleError(f"expected a readable file, got {error.strerror}") from error


def _digest(content: Mapping[str, Any], tensors: Mapping[str, NDArray[Any]]) -> str:
    """SHA-256 of a manifest without its own `sha256`, and of all tensors."""
    digest = hashlib.sha256(json.dumps(content, sort_keys=True, allow_nan=False).encode())
    for name in sorted(tensors):
        digest.update(f"{name} {tensors[name].dtype} {tensors[name].shape}".encode())
        digest.update(tensors[name].tobytes())
    return digest.hexdigest()


_NO_SENSOR: Final = SensorModel(
    detection_noise_px=0.0,
    encoder_resolution_rad=0.0,
    velocity_resolution_rad_s=0.0,
    dropped_frame_probability=0.0,
    max_smear_px=0.0,
)
_JSON_TYPE_NAMES: Final = {str: "text", float: "number with a point", list: "list", dict: "table"}


def sensorless_digest(head: HeadModel) -> str:
    """Digest of a head without its sensor: heads with the same digest share their networks.

    Quantisation of encoders and commands, noise and backlash are properties of the loop. The
    inputs, and the stages after a network's output, take them into account for the actual head.
    """
    return dataclasses.replace(head, sensor=_NO_SENSOR).digest


def describe_actions(kind: str, head: HeadModel, layout: ObservationLayout) -> dict[str, Any]:
    """Describe the actions that a network's outputs y in [-1, 1] stand for: gains or velocities."""
    if kind == GAIN_SCHEDULE:
        names = list(gain_names_of_head(head))
        limit = [GAIN_LIMIT] * len(names)
        return {"names": names, "unit": "1/s", "limit": limit, "value": "limit ((1 + y) / 2)^2"}
    if kind == POLICY:
        limit = layout.action_limits[: layout.count].tolist()
        names = list(layout.action_names)
        return {"names": names, "unit": "rad/s", "limit": limit, "value": "limit y^3"}
    raise BundleError(f"kind: expected {GAIN_SCHEDULE} or {POLICY}, got {kind!r}")


def _first_difference(expected: Any, got: Any, path: str) -> tuple[str, Any, Any] | None:
    """Return dotted path and both values of the first difference of two plain values, or None."""
    if isinstance(expected, dict) and isinstance(got, dict):
        pairs = [(f"{path}.{key}", expected.get(key), got.get(key)) for key in {**expected, **got}]
    elif isinstance(expected, list) and isinstance(got, list) and len(expected) == len(got):
        both = zip(expected, got, strict=True)
        pairs = [(f"{path}[{index}]", *pair) for index, pair in enumerate(both)]
    else:
        return None if expected == got else (path, expected, got)
    found = (_first_difference(a, b, place) for place, a, b in pairs)
    return next((one for one in found if one is not None), None)


def _parse(text: str, tensors: Mapping[str, NDArray[Any]]) -> Manifest:
    """Read a manifest, and check that it and the tensors are those that were written."""

    def refuse(word: str) -> Any:
        raise ValueError(f"{word}, which JSON does not have")

    try:
        content = json.loads(text, parse_constant=refuse)
    except (ValueError, RecursionError) as error:
        raise BundleError(f"manifest: expected JSON, got {error}") from error
    if not isinstance(content, dict):
        raise BundleError(f"manifest: expected a table, got {content!r:.60}")
    for key, expected in (("format", FORMAT), ("version", FORMAT_VERSION)):
        if content.get(key) != expected:
            raise BundleError(f"manifest: {key}: expected {expected!r}, got {content.get(key)!r}")
    stated = content.pop("sha256", None)
    if stated != _digest(content, tensors):
        raise BundleError("expected the content that its SHA-256 states, got damage or an edit")
    fields = {name: value for name, value in content.items() if name not in ("format", "version")}
    known = [field.name for field in dataclasses.fields(Manifest)]
    if sorted(fields) != sorted(known):
        raise BundleError(
            f"manifest: expected the fields {', '.join(known)}, got {', '.join(sorted(fields))}"
        )
    kinds: dict[str, type] = {"kind": str, "period_s": float, "joints": list}
    for key, value in fields.items():
        kind = kinds.get(key, dict)
        if type(value) is not kind:
            raise BundleError(
                f"manifest: {key}: expected a {_JSON_TYPE_NAMES[kind]}, got {value!r:.60}"
            )
    return Manifest(**fields)
