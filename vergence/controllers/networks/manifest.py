"""The manifest of a bundle, and the checks that it fits a head."""

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from vergence.controllers.gain_schedule import GAIN_LIMIT, gain_names_of_head
from vergence.controllers.networks.inputs import Inputs
from vergence.envs.observation import ObservationLayout
from vergence.errors import BundleError, ConfigurationError, OtherHeadError, UnknownNameError
from vergence.models.head import HeadModel
from vergence.models.parts import JOINTS, SensorModel

FORMAT: Final = "vergence-bundle"
FORMAT_VERSION: Final = 1
"""Version of the bundle format (numerical)."""
GAIN_SCHEDULE: Final = "gain-schedule"
POLICY: Final = "policy"
NETWORK_PART: Final = "policy.onnx"


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
    """`names`, `unit`, and the values `low` and `high` of outputs -1 and 1."""
    training: Mapping[str, Any]
    """Record of the training: `command`, `seed`, `scenario`, `steps`, `versions` and more."""
    metrics: Mapping[str, Any]
    """Performance measured by the training run."""
    parts: Mapping[str, Any]
    """SHA-256 (hexadecimal) and size (bytes) of each other part of the bundle, by name."""

    @classmethod
    def of(
        cls,
        kind: str,
        inputs: Inputs,
        network: bytes,
        training: Mapping[str, Any],
        metrics: Mapping[str, Any],
    ) -> "Manifest":
        """Make the manifest of a network.

        Args:
            kind: `gain-schedule` or `policy`.
            inputs: inputs of the network, which include the head and the layout.
            network: the ONNX file.
            training: record of the training, plain values.
            metrics: measured performance, plain values.

        Returns:
            The manifest.

        Raises:
            BundleError: there is no such kind.
        """
        head, layout = inputs.head, inputs.layout
        return cls(
            kind=kind,
            head={"name": head.name, "digest": head.digest, "fits": sensorless_digest(head)},
            period_s=layout.period_s,
            joints=list(JOINTS),
            layout=layout.to_dict(),
            inputs=inputs.to_dict(),
            actions=describe_actions(kind, head, layout),
            training=dict(training),
            metrics=dict(metrics),
            parts={NETWORK_PART: describe_part(network)},
        )

    def to_json(self) -> bytes:
        """Encode the manifest as the bytes of `manifest.json`.

        Raises:
            BundleError: a value has no representation in JSON, such as nan.
        """
        content = {"format": FORMAT, "version": FORMAT_VERSION, **dataclasses.asdict(self)}
        try:
            text = json.dumps(content, indent=2, sort_keys=True, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise BundleError(f"manifest: expected plain finite values, got {error}") from error
        return text.encode() + b"\n"

    @classmethod
    def from_json(cls, data: bytes) -> "Manifest":
        """Read a manifest.

        Args:
            data: the bytes of `manifest.json`.

        Returns:
            The manifest; `check_fits` tests whether it fits a head.

        Raises:
            BundleError: it is no manifest of this version.
        """
        content = _parse(data)
        for key, expected in (("format", FORMAT), ("version", FORMAT_VERSION)):
            got = content.pop(key, None)
            if got != expected or isinstance(got, bool):
                raise BundleError(f"manifest: {key}: expected {expected!r}, got {got!r}")
        fields = {field.name: field.type for field in dataclasses.fields(cls)}
        if content.keys() != fields.keys():
            missing = sorted(fields.keys() - content.keys())
            unknown = sorted(content.keys() - fields.keys())
            raise BundleError(
                f"manifest: expected the fields {', '.join(fields)}, "
                f"got none of {missing} and also {unknown}"
            )
        kinds: dict[str, type] = {"kind": str, "period_s": float, "joints": list}
        for key, value in content.items():
            kind = kinds.get(key, dict)
            if type(value) is not kind:
                raise BundleError(
                    f"manifest: {key}: expected a {_JSON_TYPE_NAMES[kind]}, got {value!r:.60}"
                )
        return cls(**content)

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
            first_difference(value, getattr(self, key), key) for key, value in expected.items()
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
    """Describe the outputs of a network: value = low + (1 + output) / 2 (high - low).

    Args:
        kind: `gain-schedule` (four gains for any head) or `policy` (one velocity per actuator).
        head: the head that the network controls.
        layout: the layout of its observations and actions.

    Raises:
        BundleError: there is no such kind.
    """
    if kind == GAIN_SCHEDULE:
        names = list(gain_names_of_head(head))
        low, high = [0.0] * len(names), [GAIN_LIMIT] * len(names)
        return {"names": names, "unit": "1/s", "low": low, "high": high}
    if kind == POLICY:
        limits = layout.action_limits[: layout.count]
        low, high = (-limits).tolist(), limits.tolist()
        return {"names": list(layout.action_names), "unit": "rad/s", "low": low, "high": high}
    raise BundleError(f"kind: expected {GAIN_SCHEDULE} or {POLICY}, got {kind!r}")


def describe_part(data: bytes) -> dict[str, Any]:
    """Return hash and size of a part."""
    return {"sha256": hashlib.sha256(data).hexdigest(), "size": len(data)}


def first_difference(expected: Any, got: Any, path: str) -> tuple[str, Any, Any] | None:
    """Return dotted path and both values of the first difference of two plain values, or None."""
    if isinstance(expected, dict) and isinstance(got, dict):
        for key in {**expected, **got}:
            found = first_difference(expected.get(key), got.get(key), f"{path}.{key}")
            if found is not None:
                return found
        return None
    if isinstance(expected, list) and isinstance(got, list) and len(expected) == len(got):
        for index, (a, b) in enumerate(zip(expected, got, strict=True)):
            found = first_difference(a, b, f"{path}[{index}]")
            if found is not None:
                return found
        return None
    return None if expected == got else (path, expected, got)


def _parse(data: bytes) -> dict[str, Any]:
    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        table = dict(pairs)
        if len(table) != len(pairs):
            raise ValueError("a key twice")
        return table

    def refuse(word: str) -> Any:
        raise ValueError(f"{word}, which JSON does not have")

    try:
        content = json.loads(data.decode("utf-8"), object_pairs_hook=unique, parse_constant=refuse)
    except (ValueError, RecursionError) as error:
        raise BundleError(f"manifest: expected JSON, got {error}") from error
    if not isinstance(content, dict):
        raise BundleError(f"manifest: expected a table, got {content!r:.60}")
    return content
