r"""Inputs of a network, computed from observations, and their state.

The observation of `vergence/Gaze-v0` has everything a policy needs, but not in a form that a small
network can use. A gaze settles when the present error is below 1 px, and the present error is the
small difference of large numbers: the error in an old image, and the angles that the joints have
turned since its exposure. These inputs compute that difference with the head's kinematics, and
include the loop parameters that the predictor has estimated.

Each channel exists for every actuator of the eyes. If each of the four eye joints has its own
motor, one small network can serve all of them (`Inputs.by_joint`). Every channel lies in [-1, 1];
angles and velocities come in several resolutions. A linear channel saturates; a logarithmic one,

    sign(x) ln(1 + |x| / x0) / ln(1 + x_max / x0)

resolves every magnitude with the same relative resolution.

In a robot's loop some detections are outliers. The predictor rejects them; the images that enter
`predicted` directly pass the outlier gate of the fixed laws first (`OutlierGate`).

The channels are part of the contract between a training run and its bundle: `Inputs.to_dict` goes
into the manifest, and `VERSION` grows with every change of a channel's meaning.
"""

from math import log, log1p
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.controllers.gate import OutlierGate
from vergence.controllers.ibvs import ibvs_velocities
from vergence.controllers.prediction.parameters import actuator_moves_eye
from vergence.controllers.prediction.predictor import SmithPredictor, prediction_fields
from vergence.envs.observation import Observation, ObservationLayout
from vergence.errors import ConfigurationError, UnknownNameError
from vergence.kernels import inlined, kernel
from vergence.models.head import HeadModel
from vergence.models.parts import EYES, JOINTS, FloatArray

VERSION: Final = 2
"""Version of the channels' meaning (numerical)."""
COARSE_RAD: Final = 1.5
"""Angle of a coarse channel's value 1, rad (chosen: range of the joints)."""
MIDDLE_RAD: Final = 0.1
"""Angle of a middle channel's value 1, rad (chosen)."""
FINE_RAD: Final = 0.01
"""Angle of a fine channel's value 1, rad (chosen)."""
LOG_RAD: Final = 0.001
"""x0 of the logarithmic channel of angles, rad (chosen)."""
LOG_SPEED: Final = 0.005
"""x0 of the logarithmic channel of velocities, as a fraction of the largest command (chosen)."""


MAX_TO_GO_SHARE: Final = 2.0
"""Saturation of the ratio `to_go_share` (chosen)."""
MAX_LATENCY_S: Final = 0.1
"""Saturation of lags and latencies, s (chosen)."""
MAX_LATENCY_SD_S: Final = 0.02
"""Saturation of the latency's standard deviation, s (chosen)."""
MAX_ACCELERATION_RATIO: Final = 4.0
"""Saturation of the acceleration ratio, and of its inverse (chosen)."""
MAX_SPEED_GAIN: Final = 1.5
"""Saturation of the speed gain, and of its inverse (chosen)."""
MIN_REQUESTED_RAD: Final = 1e-5
"""Lower bound of the divisor in `to_go_share`, rad (numerical)."""


class _Share(NamedTuple):
    """Channels that compare the remaining turn with the turn requested by the newest image."""

    asked: float
    asked_log: float
    to_go_share: float


class _Present(NamedTuple):
    """Channels of one actuator's present state."""

    to_go: float
    to_go_log: float
    to_go_middle: float
    to_go_fine: float
    to_rest_log: float
    to_rest_middle: float
    to_rest_fine: float
    velocity: float
    velocity_log: float
    command: float
    lag: float
    acceleration: float
    acceleration_sd: float
    gain: float
    latency: float
    latency_sd: float
    rate: float
    later_rate: float
    known: float


CHANNELS: Final = {
    "predicted": (*_Share._fields, *_Present._fields),
    "to_go": _Present._fields,
}
"""Channels of each kind of inputs, for each actuator of the eyes.

| channel | meaning |
| --- | --- |
| `asked` | turn requested by the newest image's error / 1.5 rad; `_log` with x0 = 1 mrad |
| `to_go` | remaining turn from the present angle / 1.5 rad; `_log` with x0 = 1 mrad |
| `to_go_middle`, `to_go_fine` | remaining turn / 0.1 and 0.01 rad, saturated |
| `to_go_share` | remaining turn / requested turn / 2, saturated |
| `to_rest_...` | turn that would remain after coming to rest under zero command |
| `velocity` | velocity / largest command; `_log` with x0 = 0.005 |
| `command` | present command / largest command |
| `lag` | estimated lag / 0.1 s |
| `acceleration` | log of the ratio of estimated to modelled acceleration limit / ln 4 |
| `acceleration_sd` | standard deviation of that logarithm |
| `gain` | log of the estimated ratio of velocity to command / ln 1.5 |
| `latency` | estimated latency of commands plus readings / 0.1 s |
| `latency_sd` | its standard deviation / 0.02 s |
| `rate` | growth rate of the remaining turn while it rests / largest command: a moving target |
| `later_rate` | this rate when a command given now takes effect |
| `known` | 1 if the target of an eye that it moves is known, otherwise 0 |

`predicted` is for gain schedules: its angles and velocities are positive in the direction in which
the law turns the actuator, as the best gain does not depend on that direction.
"""


KINDS: Final = {
    kind: tuple(f"{channel}_{joint}" for channel in channels for joint in JOINTS[EYES])
    for kind, channels in CHANNELS.items()
}
"""Names of all inputs of each kind, in their order, for a head with a motor for each eye joint."""
_PRESENT_CHANNELS: Final = len(_Present._fields)
_RESPONSE_FIELDS: Final = (
    "acceleration_ratio", "acceleration_sd", "response_latency_s", "response_latency_sd_s",
)  # fmt: skip
_UNIT_GAINS: Final = np.ones((2, 2))
_NO_SPEED_LIMITS: Final = np.full(4, 1e9)


class Inputs:
    """The inputs of a network for one head.

    Args:
        kind: `predicted` or `to_go`, see `CHANNELS`.
        head: the model of the head.
        layout: the layout of observations; None for the head's own.

    Raises:
        UnknownNameError: there is no such kind.
    """

    def __init__(self, kind: str, head: HeadModel, layout: ObservationLayout | None = None) -> None:
        if kind not in list(CHANNELS):  # a list accepts unhashable names, too
            raise UnknownNameError("inputs", kind, sorted(CHANNELS))
        self.kind = kind
        self.head = head
        self.layout = layout = ObservationLayout.of(head) if layout is None else layout
        self.names = tuple(
            f"{one}_{name}" for one in CHANNELS[kind] for name in layout.action_names
        )
        self.predictor = SmithPredictor(head=head, layout=layout)
        self._gate = OutlierGate(head, layout) if kind == "predicted" else None
        self._acceleration = np.array(head.actuation.acceleration[EYES])
        self._lag_ratio = np.array(head.actuation.lag_ratio[EYES])
        self._moved = actuator_moves_eye(head).T
        # the predictor's state comes first, as it accepts rows with further entries after it
        gate = () if self._gate is None else (self._gate.initial(),)
        self._initial = np.concatenate([self.predictor.initial(), *gate])
        self._of_gate = slice(self.predictor.size, self._initial.size)

    @property
    def size(self) -> int:
        """Number of inputs of the network."""
        return len(self.names)

    @property
    def by_joint(self) -> NDArray[np.int64] | None:
        """(4, channels) indices of each joint's own inputs.

        None for a head whose eye joints do not each have their own motor.
        """
        if not self.head.actuation.direct:
            return None
        return np.arange(self.size).reshape(-1, 4).T.copy()

    @property
    def known_indices(self) -> slice:
        """Indices of the inputs (m) in which 1 means that the actuator has a target."""
        return slice(self.size - self.layout.count, self.size)

    def initial(self) -> FloatArray:
        """(state_size,) state at a trial's start."""
        return self._initial.copy()

    def update(
        self, seen: Observation, state: FloatArray
    ) -> tuple[NDArray[np.float32], FloatArray]:
        """Compute the network's inputs, and return the prediction they are based on.

        Args:
            seen: observations of the gaze task, each passed exactly once.
            state: (..., state_size or more) the state, updated in place; C-contiguous float64.
                Entries after the state in each row belong to the caller.

        Returns:
            (..., size) inputs in [-1, 1], and the predictor's rows, see `Prediction`.
        """
        asked = np.zeros(4)
        if self._gate is not None:
            seen_by_law = self._gate.update(seen, state[..., self._of_gate])
            asked = ibvs_velocities(
                self.head, seen_by_law.positions_at_exposure, seen_by_law.pixel_error,
                _UNIT_GAINS, np.nan, _NO_SPEED_LIMITS,
            )  # fmt: skip
        rows = self.predictor.update(seen, state)
        now = prediction_fields(rows)
        response_estimate = np.stack([now[name] for name in _RESPONSE_FIELDS], axis=-1)
        lags = now["lag_s"][..., None] * self._lag_ratio
        channels = present_channels(
            asked, now["angle_error"], now["velocities"], seen.last_command,
            self.layout.action_limits, self._acceleration, lags,
            now["goal_rates"], now["goal_rates_at_effect"], now["speed_gain"], response_estimate,
            now["known"] @ self._moved > 0.5, np.empty((len(CHANNELS[self.kind]), 4)),
        )  # fmt: skip
        channels = channels[..., : self.layout.count]
        return channels.reshape(*channels.shape[:-2], self.size).astype(np.float32), rows

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
        inputs = cls(str(fields.get("kind")), head, layout)
        if fields.get("names") != list(inputs.names):
            raise ConfigurationError(
                f"inputs.names: expected the {inputs.size} of {inputs.kind}, "
                f"got {fields.get('names')!r}"
            )
        return inputs


@inlined
def clip_to_unit(value: float) -> float:
    """Clip a scaled value to [-1, 1]: a linear channel, which saturates."""
    return min(max(value, -1.0), 1.0)


@inlined
def symlog_scaled(value: float, linear_threshold: float, full_scale: float) -> float:
    """Scale a value to [-1, 1] logarithmically, with its sign."""
    size = min(log1p(abs(value) / linear_threshold) / log1p(full_scale / linear_threshold), 1.0)
    return size if value >= 0.0 else -size


@inlined
def _coasting(v: float, lag: float, a: float) -> float:
    """Signed angle that an actuator turns until it rests under zero command from now on, rad."""
    speed, least = abs(v), a * lag
    turn = speed * lag
    if speed > least:
        # constant deceleration a until the speed is a * lag, exponential decay afterwards
        turn = (speed * speed - least * least) / (2.0 * a) + least * lag
    return turn if v >= 0.0 else -turn


@inlined
def _present(
    to_go: float, v: float, u: float, limit: float, a: float, lag: float, rate: float,
    later_rate: float, gain: float, response_estimate: FloatArray, known: bool,
) -> _Present:  # fmt: skip
    rest, sees = to_go - _coasting(v, lag, response_estimate[0] * a), 1.0 if known else 0.0
    return _Present(
        to_go=clip_to_unit(to_go / COARSE_RAD),
        to_go_log=symlog_scaled(to_go, LOG_RAD, COARSE_RAD),
        to_go_middle=clip_to_unit(to_go / MIDDLE_RAD),
        to_go_fine=clip_to_unit(to_go / FINE_RAD),
        to_rest_log=symlog_scaled(rest, LOG_RAD, COARSE_RAD),
        to_rest_middle=clip_to_unit(rest / MIDDLE_RAD),
        to_rest_fine=clip_to_unit(rest / FINE_RAD),
        velocity=clip_to_unit(v / limit),
        velocity_log=symlog_scaled(v / limit, LOG_SPEED, 1.0),
        command=clip_to_unit(u / limit),
        lag=min(lag / MAX_LATENCY_S, 1.0),
        acceleration=clip_to_unit(log(response_estimate[0]) / log(MAX_ACCELERATION_RATIO)),
        acceleration_sd=min(response_estimate[1], 1.0),
        gain=clip_to_unit(log(gain) / log(MAX_SPEED_GAIN)),
        latency=clip_to_unit(response_estimate[2] / MAX_LATENCY_S),
        latency_sd=min(response_estimate[3] / MAX_LATENCY_SD_S, 1.0),
        rate=clip_to_unit(rate / limit),
        later_rate=clip_to_unit(later_rate / limit),
        known=sees,
    )


@kernel(
    ["(f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],b1[:],f8[:,:],f8[:,:])"],
    "(4),(4),(4),(4),(4),(4),(4),(4),(4),(4),(4),(4),(c,4)->(c,4)",
)
def present_channels(
    requested_turn: FloatArray, to_go: FloatArray, velocity: FloatArray, command: FloatArray,
    command_limits: FloatArray, acceleration_limit: FloatArray, lag: FloatArray,
    goal_rate: FloatArray, goal_rate_at_effect: FloatArray, speed_gain: FloatArray,
    response_estimate: FloatArray, known: NDArray[np.bool_], shape_only: FloatArray,
    out: FloatArray,
) -> None:  # fmt: skip
    """Compute the channels of `to_go` or `predicted`, by the number of rows of `shape_only`.

    `response_estimate` holds `_RESPONSE_FIELDS`; angles in rad, times in s, as in `Prediction`.
    """
    # with the channels of `_Share`, signs are relative to the direction of the requested turn
    first = max(out.shape[0] - _PRESENT_CHANNELS, 0)
    for j in range(4):
        if not command_limits[j] > 0.0:  # no such actuator
            for c in range(out.shape[0]):
                out[c, j] = 0.0
            continue
        side = 1.0
        if first > 0:
            side = 1.0 if requested_turn[j] >= 0.0 else -1.0
            turn, left = side * requested_turn[j], side * to_go[j]
            share = _Share(
                asked=clip_to_unit(turn / COARSE_RAD),
                asked_log=symlog_scaled(turn, LOG_RAD, COARSE_RAD),
                to_go_share=clip_to_unit(left / max(turn, MIN_REQUESTED_RAD) / MAX_TO_GO_SHARE),
            )
            for c in range(min(len(share), first)):
                out[c, j] = share[c]
        present = _present(
            side * to_go[j], side * velocity[j], side * command[j], command_limits[j],
            acceleration_limit[j],
            lag[j], side * goal_rate[j], side * goal_rate_at_effect[j], speed_gain[j],
            response_estimate, known[j],
        )  # fmt: skip
        for c in range(min(len(present), out.shape[0])):
            out[first + c, j] = present[c]
