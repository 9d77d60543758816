"""Learned controllers: a network from a bundle or an ONNX file, with the interface `predict`.

Nothing here unpickles or evaluates anything: a bundle is a manifest in JSON and a graph of a few
known operators, checked before it reaches the runtime (`vergence.controllers.networks.bundle`).
"""

import os
from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from vergence.controllers.controller import Controller
from vergence.controllers.fitting import checked_layout
from vergence.controllers.gain_schedule import (
    GAIN_LIMIT,
    TILT_FIRST_GAIN_NAMES,
    gain_indices_by_axis,
    gain_names_of_head,
)
from vergence.controllers.networks.acting import NetworkPrePostProcessor
from vergence.controllers.networks.bundle import (
    SUFFIX,
    Bundle,
    prefix_bundle_errors,
    pretrained_bundles,
    read_bundle,
    read_limited,
)
from vergence.controllers.networks.inputs import Inputs
from vergence.controllers.networks.manifest import GAIN_SCHEDULE, POLICY
from vergence.controllers.networks.onnx_graph import MAX_NETWORK_BYTES, Network, read_network
from vergence.controllers.networks.runtime import Runtime
from vergence.controllers.stateful import continued_state
from vergence.envs.observation import ObservationLayout
from vergence.errors import BundleError, ConfigurationError, OtherHeadError
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

Action = NDArray[np.float32]
"""Arrays of actions, and of a network's inputs and outputs."""


class _Learned(ABC):
    """Computes actions from observations with a network whose outputs range from -1 to 1."""

    nan_replacement: ClassVar[float]
    """Output in place of nan, at which the eyes rest: velocity 0, or -1, which is gain 0."""
    outputs_gains: ClassVar[bool] = False
    """True if the network chooses gains, False for velocities."""

    def __init__(self, inputs: Inputs, network: Network, source: str) -> None:
        for what, expected, got in (
            ("inputs", inputs.size, network.input_size),
            ("outputs", self._outputs(inputs), network.output_size),
        ):
            if expected != got:
                raise BundleError(f"{source}: network: expected {expected} {what}, got {got}")
        self.head = inputs.head
        self.layout = inputs.layout
        self.inputs = inputs
        self._acting = NetworkPrePostProcessor(inputs, self.outputs_gains)
        with prefix_bundle_errors(source):
            self._runtime = Runtime(network)

    def predict(
        self,
        observation: NDArray[Any],
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[Any] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[NDArray[Any], ...] | None]:
        """Choose actions, see `Controller.predict`; `state` is the pre- and postprocessor's."""
        observation = np.asarray(observation)
        memory = continued_state(
            self._acting.initial(), observation.shape[:-1], state, episode_start
        )
        seen = self._acting.network_inputs(observation, memory)
        return self._action(observation, seen, self._run(seen), memory), (memory,)

    def outputs(
        self,
        observation: NDArray[Any],
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[Any] | None = None,
    ) -> tuple[NDArray[np.float32], tuple[NDArray[Any], ...]]:
        """Compute the outputs of the network.

        Args:
            observation: (..., size) observations of the gaze task.
            state: the state returned by the last call; None at the start.
            episode_start: (...) True for an episode that has just begun.

        Returns:
            (..., outputs) in [-1, 1], where -1 and 1 stand for `low` and `high` of the manifest's
            actions, linear in between, and the state for the next call.
        """
        observation = np.asarray(observation)
        leading = observation.shape[:-1]
        memory = continued_state(self._acting.initial(), leading, state, episode_start)
        return self._run(self._acting.network_inputs(observation, memory)), (memory,)

    def _run(self, seen: NDArray[np.float32]) -> NDArray[np.float32]:
        out = self._runtime(seen)
        np.clip(out, -1.0, 1.0, out=out)
        out[np.isnan(out)] = self.nan_replacement
        return out

    @staticmethod
    def _outputs(inputs: Inputs) -> int:
        """Number of outputs of the network: one per actuator."""
        return inputs.layout.count

    @abstractmethod
    def _action(
        self, observation: NDArray[Any], seen: Action, outputs: Action, memory: FloatArray
    ) -> Action:
        """Compute the environment's action from the network's outputs; update `memory` in place."""


class BundledNetwork(_Learned):
    """A network with a manifest, which states what it was trained for.

    Args:
        head: the model of the head.
        layout: the layout of observations and actions.
        bundle: path of a bundle, or the name of a shipped one; None for the one shipped for this
            head.
        allow_other_head: True to accept a bundle trained with another head's geometry.

    Raises:
        BundleError: the bundle cannot be read or does not fit.
        ConfigurationError: none is shipped for this head, or onnxruntime is not installed.
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
        super().__init__(*_fitting(opened, self.kind, head, layout, allow_other_head))
        self.manifest = opened.manifest


class LearnedPolicy(BundledNetwork):
    """Actuator velocities from a network; the arguments are those of `BundledNetwork`."""

    kind = POLICY
    nan_replacement = 0.0

    def _action(
        self, observation: NDArray[Any], seen: Action, outputs: Action, memory: FloatArray
    ) -> Action:
        return self._acting.action_from_velocities(seen, outputs, memory)


class LearnedGain(BundledNetwork):
    """The article's law with gains from a network; the arguments are those of `BundledNetwork`."""

    kind = GAIN_SCHEDULE
    nan_replacement = -1.0  # a gain of zero
    outputs_gains = True

    @staticmethod
    def _outputs(inputs: Inputs) -> int:
        return len(TILT_FIRST_GAIN_NAMES)  # by eye and image axis, whatever moves the eyes

    def _action(
        self, observation: NDArray[Any], seen: Action, outputs: Action, memory: FloatArray
    ) -> Action:
        shares = outputs[..., gain_indices_by_axis(gain_names_of_head(self.head))]
        gains = 0.5 * GAIN_LIMIT * (1.0 + shares)
        return self._acting.ibvs_action_from_gains(
            observation, gains.reshape(*gains.shape[:-1], 2, 2), memory
        )


class BareOnnxPolicy(_Learned):
    """A bare ONNX file that maps the numbers of an observation to those of an action.

    Such a file does not state which head and layout it was trained with: the caller is responsible
    for that. Outputs are clipped to [-1, 1] and are the action, without any stage in between.

    Args:
        head: the model of the head.
        layout: the layout of observations and actions.
        path: the file.

    Raises:
        BundleError: it cannot be read, is no such graph, or is not allowed.
        ConfigurationError: onnxruntime is not installed.
    """

    nan_replacement = 0.0

    def __init__(
        self, *, head: HeadModel, layout: ObservationLayout, path: str | os.PathLike[str]
    ) -> None:
        data = read_limited(path, MAX_NETWORK_BYTES)
        with prefix_bundle_errors(str(path)):
            network = read_network(data)
        inputs = Inputs.of("observation", head, checked_layout(head, layout))
        super().__init__(inputs, network, str(path))

    def _action(
        self, observation: NDArray[Any], seen: Action, outputs: Action, memory: FloatArray
    ) -> Action:
        return outputs


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
        BundleError: it cannot be read, is damaged, not allowed, or does not fit.
        ConfigurationError: onnxruntime is not installed, or the layout is another head's.
    """
    layout = checked_layout(head, layout)
    if Path(path).suffix == ".onnx":
        return BareOnnxPolicy(head=head, layout=layout, path=path)
    if Path(path).suffix != SUFFIX:
        raise BundleError(f"{path}: expected a file named *{SUFFIX} or *.onnx, got another name")
    bundle = read_bundle(path)
    make = {GAIN_SCHEDULE: LearnedGain, POLICY: LearnedPolicy}.get(bundle.manifest.kind)
    if make is None:
        raise BundleError(
            f"{path}: kind: expected {GAIN_SCHEDULE} or {POLICY}, got {bundle.manifest.kind!r}"
        )
    return make(head=head, layout=layout, bundle=path, allow_other_head=allow_other_head)


def open_bundle(kind: str, head: HeadModel, bundle: str | os.PathLike[str] | None) -> Bundle:
    """Open a bundle from a file, a shipped one by name, or the one shipped for a head.

    Args:
        kind: `gain-schedule` or `policy`.
        head: the head.
        bundle: a file's path, a shipped bundle's name, or None for the one shipped for a head of
            this name or digest.

    Returns:
        The bundle.

    Raises:
        BundleError: it cannot be read, is damaged or not allowed.
        ConfigurationError: no such bundle is shipped.
    """
    if bundle is not None and Path(bundle).suffix == SUFFIX:
        return read_bundle(bundle)
    shipped = pretrained_bundles()
    if bundle is None:
        return _shipped_for(kind, head, shipped)
    name = os.fspath(bundle)
    if name not in shipped:
        raise ConfigurationError(
            f"bundle: expected a file named *{SUFFIX} or one of the shipped "
            f"{', '.join(shipped) or '(there are none)'}, got {name!r}"
        )
    return read_bundle(shipped[name])


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


def _fitting(
    bundle: Bundle, kind: str, head: HeadModel, layout: ObservationLayout, allow_other_head: bool
) -> tuple[Inputs, Network, str]:
    if bundle.manifest.kind != kind:
        raise BundleError(f"{bundle.source}: kind: expected {kind}, got {bundle.manifest.kind!r}")
    with prefix_bundle_errors(bundle.source):
        inputs = bundle.manifest.check_fits(head, layout, allow_other_head)
    return inputs, bundle.network, bundle.source
