r"""Inputs of a network, computed from observations, and their state.

The observation of `vergence/Gaze-v0` has everything a policy needs, but not in a form that a small
network can use. A gaze settles when the present error is below 1 px, and the present error is the
small difference of large numbers: the error in an old image, and the angles that the joints have
turned since its exposure. These inputs compute that difference with the head's kinematics, and
include the loop parameters that the predictor has estimated. There are five kinds, see `KINDS`.
`error`, `history` and `observation` omit the difference, to show its benefit; `history` has all
data from which it could be computed.

All kinds except `observation` are by actuator of the eyes: each channel exists for every one. If
each of the four eye joints has its own motor, one small network can serve all of them
(`Inputs.by_joint`). Every channel lies in [-1, 1]; angles and velocities come in several
resolutions, see `vergence.controllers.networks.resolutions`.

In a robot's loop some detections are outliers. `predicted` and `to_go` rely on the predictor, which
rejects outliers; images that enter `error`, `history` and `predicted` directly pass the outlier
gate of the fixed laws first (`vergence.controllers.outlier_gate`). `observation` is raw.

The channels are part of the contract between a training run and its bundle: `Inputs.to_dict` goes
into the manifest, and `VERSION` grows with every change of a channel's meaning.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.controllers.ibvs import ibvs_velocities
from vergence.controllers.networks.channels import CHANNELS, error_channels, present_channels
from vergence.controllers.networks.history import STORED_IMAGES, InputHistory
from vergence.controllers.outlier_gate import OutlierGate
from vergence.controllers.prediction.joints import actuator_moves_eye
from vergence.controllers.prediction.predictor import Prediction, SmithPredictor
from vergence.envs.observation import FIELDS, ObservationLayout, check_observation
from vergence.errors import ConfigurationError, UnknownNameError
from vergence.models.head import HeadModel
from vergence.models.parts import EYES, JOINTS, FloatArray

VERSION: Final = 2
"""Version of the channels' meaning (numerical)."""

KINDS: Final[dict[str, tuple[str, ...]]] = {
    "observation": tuple(
        f"{name}_{i}" for name, part in FIELDS.items() for i in range(part.stop - part.start)
    ),
    **{
        kind: tuple(f"{channel}_{joint}" for channel in channels for joint in JOINTS[EYES])
        for kind, channels in CHANNELS.items()
    },
}
"""Names of all inputs of each kind, in their order, for the article's four eye joints; for any head
see `all_input_names`. `observation` is the observation of the task."""


def all_input_names(kind: str, layout: ObservationLayout) -> tuple[str, ...]:
    """Return the names of all inputs of a kind, in their order.

    Args:
        kind: one of `KINDS`.
        layout: the layout of observations, which includes the actuators.

    Raises:
        UnknownNameError: there is no such kind.
    """
    if kind not in KINDS:
        raise UnknownNameError("inputs", kind, sorted(KINDS))
    if kind in CHANNELS:
        return tuple(f"{one}_{name}" for one in CHANNELS[kind] for name in layout.action_names)
    fields = layout.fields.items()
    return tuple(f"{name}_{i}" for name, part in fields for i in range(part.stop - part.start))


class Inputs:
    """The inputs of a network for one head.

    Args:
        kind: one of `KINDS`.
        head: the model of the head.
        layout: the layout of observations.

    Raises:
        UnknownNameError: there is no such kind.
    """

    def __init__(self, kind: str, head: HeadModel, layout: ObservationLayout) -> None:
        self.names = all_input_names(kind, layout)
        self.kind = kind
        self.head = head
        self.layout = layout
        self.predictor = (
            SmithPredictor(head=head, layout=layout) if kind in _PREDICTED_KINDS else None
        )
        self._gate = OutlierGate(head, layout) if kind in _GATED_KINDS else None
        actuation = head.actuation
        self._acceleration = np.array(actuation.acceleration[EYES])
        self._lag_ratio = np.array(actuation.lag_ratio[EYES])
        self._moved = actuator_moves_eye(head).T
        moved = np.asarray(self._moved, dtype=np.float64)
        self._history = InputHistory(head, layout, moved) if kind == "history" else None
        # the predictor's state comes first, as it accepts rows with further entries after it
        remembering = (self.predictor, self._gate, self._history)
        rows = [part.initial() for part in remembering if part is not None]
        self._initial = np.concatenate(rows) if rows else np.zeros(0)
        first = 0 if self.predictor is None else self.predictor.size
        self._of_gate = slice(first, first + OutlierGate.size)
        self._of_history = slice(OutlierGate.size, OutlierGate.size + InputHistory.size)

    @classmethod
    def of(cls, kind: str, head: HeadModel, layout: ObservationLayout | None = None) -> "Inputs":
        """Make the inputs of a kind, for a head's own layout unless another one is given."""
        return cls(kind, head, ObservationLayout.of(head) if layout is None else layout)

    @property
    def size(self) -> int:
        """Number of inputs of the network."""
        return len(self.names)

    @property
    def by_joint(self) -> NDArray[np.int64] | None:
        """(4, channels) indices of each joint's own inputs.

        None for `observation`, and for a head whose eye joints do not each have their own motor.
        """
        if self.kind == "observation" or not self.head.actuation.direct:
            return None
        return np.arange(self.size).reshape(-1, 4).T.copy()

    @property
    def known_indices(self) -> NDArray[np.int64] | None:
        """(k, m) indices of inputs; a 1 in any of the k means that the actuator has a target.

        None for `observation`.
        """
        if self.kind == "observation":
            return None
        actuators = self.layout.action_names
        places = [
            [self.names.index(f"{c}_{a}") for a in actuators] for c in _KNOWN_CHANNELS[self.kind]
        ]
        return np.array(places)

    def low(self) -> NDArray[np.float32]:
        """(size,) least value of each input."""
        if self.kind == "observation":
            return self.layout.low()
        return np.full(self.size, -1.0, dtype=np.float32)

    def high(self) -> NDArray[np.float32]:
        """(size,) largest value of each input."""
        return np.ones(self.size, dtype=np.float32)

    def initial(self) -> FloatArray:
        """(state_size,) state at a trial's start."""
        return self._initial.copy()

    def update(self, observation: ArrayLike, state: FloatArray) -> NDArray[np.float32]:
        """Compute the network's inputs (..., size), see `inputs_and_prediction`."""
        return self.inputs_and_prediction(observation, state)[0]

    def inputs_and_prediction(
        self, observation: ArrayLike, state: FloatArray
    ) -> tuple[NDArray[np.float32], Prediction | None]:
        """Compute the network's inputs, and return the prediction they are based on.

        Args:
            observation: (..., n) observations of the gaze task.
            state: (..., state_size or more) the state, updated in place; C-contiguous float64.
                Entries after the state in each row belong to the caller.

        Returns:
            (..., size) inputs in [-1, 1], and the prediction; None for kinds without one.
        """
        if self.kind == "observation":
            numbers = check_observation(observation, self.layout.size)
            return np.array(numbers, dtype=np.float32), None
        seen = self.layout.decode(observation)
        limits, shape = self.layout.action_limits, np.empty((len(CHANNELS[self.kind]), 4))
        at, error, asked = seen.positions_at_exposure, seen.pixel_error, np.zeros(4)
        if self._gate is not None:
            detections = self._gate.update(seen, state[..., self._of_gate])
            at, error = detections.positions_at_exposure, detections.pixel_error
            asked = ibvs_velocities(self.head, at, error, _UNIT_GAINS, np.nan, _NO_SPEED_LIMITS)
            if self._history is not None:
                memory = state[..., self._of_history]
                channels = self._history.update(seen, detections, asked, memory, shape)
                return self._flat(channels), None
        if self.predictor is None:
            sees = np.isfinite(error).all(axis=-1)
            return self._flat(error_channels(asked, sees @ self._moved, shape)), None
        now = self.predictor.update(seen, state)
        response_estimate = (
            now.acceleration_ratio,
            now.acceleration_sd,
            now.response_latency_s,
            now.response_latency_sd_s,
        )
        out = present_channels(
            asked, now.angle_error, now.velocities, seen.last_command, limits, self._acceleration,
            now.lag_s[..., None] * self._lag_ratio, now.goal_rates, now.goal_rates_at_effect,
            now.speed_gain,
            np.stack(response_estimate, axis=-1), now.known @ self._moved, shape,
        )  # fmt: skip
        return self._flat(out), now

    def _flat(self, channels: FloatArray) -> NDArray[np.float32]:
        """Reshape (..., channels, 4) to (..., size), keeping only actuators that exist."""
        channels = channels[..., : self.layout.count]
        return channels.reshape(*channels.shape[:-2], self.size).astype(np.float32)

    def to_dict(self) -> dict[str, Any]:
        """Return the inputs as plain numbers and names, for a manifest."""
        return {"kind": self.kind, "version": VERSION, "names": list(self.names)}

    @classmethod
    def from_dict(
        cls, fields: dict[str, Any], head: HeadModel, layout: ObservationLayout | None = None
    ) -> "Inputs":
        """Make the inputs that a manifest names.

        Raises:
            ConfigurationError: it names a version or channels that this package does not support.
            UnknownNameError: there is no such kind.
        """
        if fields.get("version") != VERSION:
            raise ConfigurationError(
                f"inputs.version: expected {VERSION}, got {fields.get('version')!r}"
            )
        inputs = cls.of(str(fields.get("kind")), head, layout)
        if fields.get("names") != list(inputs.names):
            raise ConfigurationError(
                f"inputs.names: expected the {inputs.size} of {inputs.kind}, "
                f"got {fields.get('names')!r}"
            )
        return inputs


_PREDICTED_KINDS = ("predicted", "to_go")
_GATED_KINDS = ("error", "history", "predicted")
_KNOWN_CHANNELS = {
    "error": ("visible",),
    "history": tuple(f"seen_{k}" for k in range(STORED_IMAGES)),
    **dict.fromkeys(_PREDICTED_KINDS, ("known",)),
}
_UNIT_GAINS = np.ones((2, 2))
_NO_SPEED_LIMITS = np.full(4, 1e9)
