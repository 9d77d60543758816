"""Learned controllers: a network in the loop of a head, with the interface `predict`.

Between output and command stand the same elements as in the fixed laws, see
`vergence.controllers.gate`: commands are quantised to the resolution of the actuators, and the
law of a gain schedule acts on the detections that pass the outlier gate. On a head without
quantised commands and in a loop without outliers neither changes anything. A policy has no gate
here: it acts on its inputs, and `Inputs` holds outliers back. An actuator of a policy without a
target to turn to is held still: a network's output for rest is not exactly zero, and eyes that
creep while they wait would move away from where the target will appear.

A linear law can override the network. If the eyes have oscillated about their goals too often, or
the servos' own loop overshoots (no channel shows this), the law of `state-feedback` turns them.
These commands bypass `CommandQuantiser`: on a resting target they move the motors as they are.

Training environments and deployed controllers run this same code.
"""

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.controllers.adaptive import gain_names_of_head, gains_from_action
from vergence.controllers.controller import Controller, StatefulController, checked_layout
from vergence.controllers.gate import CommandQuantiser, OutlierGate
from vergence.controllers.ibvs import ibvs_velocities
from vergence.controllers.networks.bundle import (
    GAIN_SCHEDULE,
    POLICY,
    SUFFIX,
    Bundle,
    Floats,
    find_bundle,
    prefix_bundle_errors,
    pretrained_bundles,
    read_bundle,
)
from vergence.controllers.networks.inputs import Inputs
from vergence.controllers.networks.onnx import OnnxNetwork
from vergence.controllers.prediction.oscillation import OSCILLATING_HALF_SWINGS
from vergence.controllers.prediction.predictor import prediction_fields
from vergence.controllers.state_feedback import DEFAULT_LAW, linear_command
from vergence.envs.observation import Observation, ObservationLayout, check_observation
from vergence.errors import BundleError, ConfigurationError, OtherHeadError
from vergence.models.head import HeadModel
from vergence.models.parts import SLOTS, FloatArray

VELOCITY_POWER: Final = 3
"""Exponent of a policy's action decoding (chosen: resolution near zero against exploration)."""


def decode_velocity_action(action: ArrayLike) -> NDArray[np.float32]:
    """Decode a policy's action (..., m) to fractions of the velocity limits, `sign(a) |a|^3`."""
    limited = np.clip(np.asarray(action, dtype=np.float32), -1.0, 1.0)
    return np.asarray(limited**VELOCITY_POWER, dtype=np.float32)


class NetworkLoop:
    """The stages before and after a network, with one packed row of state per head.

    The caller runs the network between `network_inputs` and `command`.

    Args:
        inputs: inputs of the network, which include the head and the layout.
        schedule: True if the network chooses gains, False for velocities.
    """

    def __init__(self, inputs: Inputs, schedule: bool) -> None:
        self.inputs = inputs
        self._layout = layout = inputs.layout
        self.gain_names = gain_names_of_head(inputs.head) if schedule else None
        self._gate = OutlierGate(inputs.head, layout)
        self._quantiser = CommandQuantiser(inputs.head, layout.action_limits)
        of_inputs = inputs.initial().size
        of_gate = self._gate.size if schedule else 0
        self._of_gate = slice(of_inputs, of_inputs + of_gate)
        self._of_calm = slice(self._of_gate.stop, self._of_gate.stop + SLOTS)
        self._of_rounding = slice(self._of_calm.stop, self._of_calm.stop + SLOTS)
        self._calm_count = self._of_rounding.stop
        self._initial = np.concatenate(
            [
                inputs.initial(),
                self._gate.initial()[:of_gate],
                np.full(SLOTS, np.nan),
                np.zeros(SLOTS + 1),
            ]
        )

    def initial(self) -> FloatArray:
        """(S,) state at a trial's start."""
        return self._initial.copy()

    def linear_periods(self, state: FloatArray) -> FloatArray:
        """(...) number of periods in which the linear law has acted in the network's place."""
        return state[..., self._calm_count]

    def network_inputs(self, seen: Observation, state: FloatArray) -> Floats:
        """(..., size) inputs of the network, see `Inputs.update`; updates `state` in place."""
        inputs, now = self.inputs.update(seen, state)
        calm = self._calm(now)
        state[..., self._of_calm] = calm
        state[..., self._calm_count] += ~np.isnan(calm).all(axis=-1)
        return inputs

    def _calm(self, now: FloatArray) -> FloatArray:
        """(..., 4) commands of the linear law, rad/s; nan where the network turns the eyes."""
        fields = prediction_fields(now)
        calm = (fields["half_swing_count"] > OSCILLATING_HALF_SWINGS) | (fields["build_up"] > 0.0)
        if not calm.any():
            return np.full(SLOTS, np.nan)
        against = now.copy()
        prediction_fields(against)["velocities"] -= fields["goal_rates"]
        gain, damping = DEFAULT_LAW
        command = linear_command(
            against, self.inputs.predictor.params, np.full(SLOTS, gain), damping
        )
        command = command + fields["goal_rates_at_effect"] / fields["speed_gain"]
        return np.where(calm[..., None], command, np.nan)

    def command(
        self, seen: Observation | None, inputs: Floats, outputs: ArrayLike, state: FloatArray
    ) -> FloatArray:
        """(..., 4) velocities, rad/s, from the network's outputs (..., m) in [-1, 1].

        `seen` and `inputs` are argument and result of the last `network_inputs` (a policy needs no
        `seen`); `state` is updated in place. See `decode_velocity_action`, `gains_from_action`.
        """
        if self.gain_names is None:
            velocities = decode_velocity_action(outputs)
            velocities = np.where(inputs[..., self.inputs.known_indices] > 0.5, velocities, 0.0)
            command = np.zeros((*velocities.shape[:-1], SLOTS))
            command[..., : self._layout.count] = velocities
            command *= self._layout.action_limits
        else:
            assert seen is not None
            detections = self._gate.update(seen, state[..., self._of_gate])
            command = ibvs_velocities(
                self.inputs.head, detections.positions_at_exposure, detections.pixel_error,
                gains_from_action(outputs, self.gain_names), np.nan, self._layout.action_limits,
            )  # fmt: skip
        if self._quantiser.step_rad_s > 0.0:
            command = self._quantiser.quantise(command, state[..., self._of_rounding])
        calm = state[..., self._of_calm]
        return np.where(np.isnan(calm), command, calm)


class NetworkController(StatefulController):
    """A controller whose actions a network chooses.

    Args:
        inputs: inputs of the network, which include the head and the layout.
        network: maps (..., size) inputs to (..., m) outputs in [-1, 1]; nan is rest.
        schedule: True if the network chooses gains, False for velocities.
    """

    def __init__(self, inputs: Inputs, network: Callable[[Floats], Floats], schedule: bool) -> None:
        super().__init__(head=inputs.head, layout=inputs.layout)
        self.inputs = inputs
        self._network = network
        self._loop = NetworkLoop(inputs, schedule)
        self._at_rest = -1.0 if schedule else 0.0

    def _initial(self) -> FloatArray:
        return self._loop.initial()

    def _command(self, seen: Observation, state: FloatArray) -> FloatArray:
        inputs = self._loop.network_inputs(seen, state)
        outputs = self._network(inputs)
        outputs[np.isnan(outputs)] = self._at_rest
        return self._loop.command(seen, inputs, outputs, state)

    def linear_periods(self, state: tuple[NDArray[Any], ...]) -> FloatArray:
        """(...) periods so far in which the linear law acted in the network's place."""
        return self._loop.linear_periods(state[0])


class BundledNetwork(NetworkController):
    """A network with a manifest, which states what it was trained for.

    Args:
        head: the model of the head.
        layout: the layout of observations and actions.
        bundle: path of a bundle, or the name of a shipped one; None for the one shipped for this
            head.
        allow_other_head: True to accept a bundle trained with another head's geometry.

    Raises:
        BundleError: the bundle cannot be read or does not fit.
        ConfigurationError: none is shipped for this head.
    """

    kind: ClassVar[str]
    """Kind of bundle that it takes."""

    def __init__(
        self,
        *,
        head: HeadModel,
        layout: ObservationLayout,
        bundle: str | os.PathLike[str] | None = None,
        allow_other_head: bool = False,
    ) -> None:
        opened = open_bundle(self.kind, head, bundle)
        self.manifest = opened.manifest
        with prefix_bundle_errors(opened.source):
            if opened.manifest.kind != self.kind:
                raise BundleError(f"kind: expected {self.kind}, got {opened.manifest.kind!r}")
            inputs = opened.manifest.check_fits(head, layout, allow_other_head)
            outputs = len(opened.manifest.actions["names"])
            for what, expected, got in (
                ("inputs", inputs.size, opened.network.input_size),
                ("outputs", outputs, opened.network.output_size),
            ):
                if expected != got:
                    raise BundleError(f"network: expected {expected} {what}, got {got}")
        super().__init__(inputs, opened.network, self.kind == GAIN_SCHEDULE)


class LearnedPolicy(BundledNetwork):
    """Actuator velocities from a network; the arguments are those of `BundledNetwork`."""

    kind = POLICY


class LearnedGain(BundledNetwork):
    """The article's law with gains from a network; the arguments are those of `BundledNetwork`."""

    kind = GAIN_SCHEDULE


class BareOnnxPolicy:
    """A bare ONNX file that maps the numbers of an observation to those of an action.

    Such a file does not state which head and layout it was trained with: the caller is responsible
    for that. Outputs are clipped to [-1, 1] and are the action, without any stage in between; nan
    is rest.

    Args:
        head: the model of the head.
        layout: the layout of observations and actions.
        path: the file.

    Raises:
        BundleError: it cannot be read or is no such network.
        ConfigurationError: onnxruntime is not installed.
    """

    def __init__(
        self, *, head: HeadModel, layout: ObservationLayout, path: str | os.PathLike[str]
    ) -> None:
        self.head = head
        self.layout = checked_layout(head, layout)
        self._network = OnnxNetwork(path, layout.size, layout.count)

    def predict(
        self,
        observation: NDArray[Any],
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[Any] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[NDArray[Any], ...] | None]:
        """Choose actions, see `Controller.predict`; the network has no state."""
        seen = check_observation(observation, self.layout.size).astype(np.float32)
        return np.clip(np.nan_to_num(self._network(seen), nan=0.0), -1.0, 1.0), state


def load_policy(
    path: str | os.PathLike[str],
    head: HeadModel,
    layout: ObservationLayout | None = None,
    allow_other_head: bool = False,
) -> Controller:
    """Load a controller from a file.

    Args:
        path: a `.vgp` bundle or a bare `.onnx` network.
        head: the model of the head to control.
        layout: the layout of observations and actions; None for the head's own.
        allow_other_head: True to accept a bundle trained with another head's geometry.

    Returns:
        The controller.

    Raises:
        BundleError: it cannot be read, is damaged, or does not fit.
        ConfigurationError: onnxruntime is not installed for a bare network, or the layout is
            another head's.
    """
    if not isinstance(path, str | os.PathLike):
        raise ConfigurationError(f"path: expected a file's path, got {path!r:.80}")
    if not isinstance(head, HeadModel):
        raise ConfigurationError(f"head: expected a HeadModel, see load_head, got {head!r:.80}")
    layout = checked_layout(head, layout)
    if Path(path).suffix == ".onnx":
        return BareOnnxPolicy(head=head, layout=layout, path=path)
    if Path(path).suffix != SUFFIX:
        raise BundleError(f"{path}: expected a file named *{SUFFIX} or *.onnx, got another name")
    kind = read_bundle(path).manifest.kind
    make = {GAIN_SCHEDULE: LearnedGain, POLICY: LearnedPolicy}.get(kind)
    if make is None:
        raise BundleError(f"{path}: kind: expected {GAIN_SCHEDULE} or {POLICY}, got {kind!r}")
    return make(head=head, layout=layout, bundle=path, allow_other_head=allow_other_head)


def open_bundle(kind: str, head: HeadModel, bundle: str | os.PathLike[str] | None) -> Bundle:
    """Open a bundle from a file, a shipped one by name, or (None) the one shipped for a head.

    Raises:
        BundleError: it cannot be read or is damaged.
        ConfigurationError: no such bundle is shipped.
    """
    if bundle is None:
        return _shipped_for(kind, head, pretrained_bundles())
    return find_bundle(bundle)


def _shipped_for(kind: str, head: HeadModel, shipped: Mapping[str, Path]) -> Bundle:
    """Return the shipped bundle of a kind for a head's name, or for its digest."""
    if f"{kind}-{head.name}" in shipped:
        return read_bundle(shipped[f"{kind}-{head.name}"])
    of_kind = [read_bundle(path) for name, path in shipped.items() if name.startswith(f"{kind}-")]
    for bundle in of_kind:
        if bundle.manifest.is_for(head):
            return bundle
    fitting = ", ".join(bundle.manifest.fits for bundle in of_kind) or "none"
    raise OtherHeadError(
        f"bundle: expected a network trained for head {head.name!r} ({head.digest[:12]}), got none "
        f"with the package, which fits {fitting}: `vergence train {kind} --head FILE` learns one, "
        f"`vergence export bundle RUN NAME{SUFFIX}` makes it a file for the option `bundle`"
    )
