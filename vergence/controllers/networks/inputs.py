r"""What a network sees of an observation, and what it remembers.

The observation of `vergence/Gaze-v0` has everything a policy needs, but not in a form that a
small network can use: a gaze settles when the present error is below 1 px, and the present error
is the small difference of large numbers (what an old image shows, and how far the joints have
turned since its exposure). These inputs form that difference with the head's kinematics before
the network sees it. Four kinds exist, see `KINDS`; `error` and `observation` leave the
difference out and serve to show what it brings.

All but `observation` speak of joints: each channel exists for the four eye joints in their
order, so that one small network can serve all of them (`Inputs.by_joint`). Every channel lies in
[-1, 1]. Angles and velocities come in several resolutions: linear channels that saturate, and a
logarithmic one,

    sign(x) ln(1 + |x| / x0) / ln(1 + x_max / x0)

which resolves every size of a quantity by the same share.

The numbers are part of the contract between a training run and its bundle: `Inputs.to_dict` goes
into the manifest, and `VERSION` grows with every change of what a channel means.
"""

from math import log1p
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence._jit import device, kernel
from vergence.controllers.ibvs import ibvs_command
from vergence.controllers.prediction.predictor import Predictor
from vergence.envs.layout import FIELDS, ObservationLayout
from vergence.errors import ConfigurationError, UnknownNameError
from vergence.models.head import HeadModel
from vergence.models.joints import EYES, JOINTS
from vergence.models.parts import FloatArray

VERSION: Final = 1
"""Version of what the channels mean."""

COARSE_RAD: Final = 1.5
MIDDLE_RAD: Final = 0.1
FINE_RAD: Final = 0.01
LOG_RAD: Final = 0.001
LOG_SPEED: Final = 0.005
"""x0 of the logarithmic channel of velocities, by the joint's greatest command."""
MOST_SHARE: Final = 2.0
LONGEST_LAG_S: Final = 0.1
LEAST_ASKED_RAD: Final = 1e-5


class _Error(NamedTuple):
    """What the newest image says of one joint."""

    asked: float
    asked_log: float
    visible: float


class _Share(NamedTuple):
    """How the turn that is left compares with the one that the newest image asks for."""

    asked: float
    asked_log: float
    to_go_share: float


class _Present(NamedTuple):
    """Where one joint stands now."""

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
    known: float


CHANNELS: Final = {
    "error": _Error._fields,
    "predicted": (*_Share._fields, *_Present._fields),
    "to_go": _Present._fields,
}
"""The channels of the kinds that speak of joints; each exists for the four eye joints.

| channel | what it is |
| --- | --- |
| `asked` | the turn that the newest image's error asks for, by 1.5 rad; `_log` from 1 mrad |
| `visible` | whether the joint's eye sees the target: 1 or 0 |
| `to_go` | the turn that is left from the present angle, by 1.5 rad; `_log` from 1 mrad |
| `to_go_middle`, `to_go_fine` | the same by 0.1 and 0.01 rad, saturated |
| `to_go_share` | the turn that is left by the turn asked for, by 2, saturated |
| `to_rest_...` | the turn that were left if the joint came to rest under a command of zero |
| `velocity` | the joint's velocity by its greatest command; `_log` from 0.005 of it |
| `command` | the command that holds, by the greatest |
| `lag` | the lag of the joints, as estimated, by 0.1 s |
| `known` | whether it is known where the target of the joint's eye is: 1 or 0 |

`error` is without memory: it knows the newest image and nothing else. In `error` and `predicted`,
which are for gain schedules, all angles and velocities count in the direction in which the law
turns the joint: the best gain does not depend on it.
"""

KINDS: Final[dict[str, tuple[str, ...]]] = {
    "observation": tuple(
        f"{name}_{i}" for name, part in FIELDS.items() for i in range(part.stop - part.start)
    ),
    **{
        kind: tuple(f"{channel}_{joint}" for channel in channels for joint in JOINTS[EYES])
        for kind, channels in CHANNELS.items()
    },
}
"""The names of all numbers of each kind, in their order; `observation` is that of the task."""


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
        if kind not in KINDS:
            raise UnknownNameError("inputs", kind, sorted(KINDS))
        self.kind = kind
        self.head = head
        self.layout = layout
        self.names = KINDS[kind]
        self._predictor = (
            Predictor(head=head, layout=layout) if kind in ("predicted", "to_go") else None
        )
        self._acceleration = np.array(head.limits.acceleration[EYES])

    @classmethod
    def of(cls, kind: str, head: HeadModel, layout: ObservationLayout | None = None) -> "Inputs":
        """The inputs of a kind, for a head's own layout unless another is given."""
        return cls(kind, head, ObservationLayout.of(head) if layout is None else layout)

    @property
    def size(self) -> int:
        """How many numbers a network sees."""
        return len(self.names)

    @property
    def by_joint(self) -> NDArray[np.int64] | None:
        """(4, channels) where each joint's own numbers are; None for `observation`."""
        if self.kind == "observation":
            return None
        return np.arange(self.size).reshape(-1, 4).T.copy()

    def low(self) -> NDArray[np.float32]:
        """(size,) the least value of each number."""
        if self.kind == "observation":
            return self.layout.low()
        return np.full(self.size, -1.0, dtype=np.float32)

    def high(self) -> NDArray[np.float32]:
        """(size,) the greatest value of each number."""
        return np.ones(self.size, dtype=np.float32)

    def initial(self) -> FloatArray:
        """(state_size,) what is remembered when a trial begins."""
        return np.zeros(0) if self._predictor is None else self._predictor.initial()

    def update(self, observation: ArrayLike, state: FloatArray) -> NDArray[np.float32]:
        """What the network sees now.

        Args:
            observation: (..., 27) observations of the gaze task.
            state: (..., state_size) what is remembered; brought up to date in place.

        Returns:
            (..., size) inputs in [-1, 1].
        """
        if self.kind == "observation":
            return np.array(observation, dtype=np.float32)
        seen = self.layout.decode(observation)
        limits, shape = self.layout.action_limits, np.empty((self.size // 4, 4))
        asked = ibvs_command(
            seen.positions_at_exposure,
            seen.pixel_error,
            _UNIT,
            np.nan,
            _UNLIMITED,
            self.head.packed,
        )
        if self._predictor is None:
            return self._flat(_see_error(asked, seen.visible, shape))
        now = self._predictor.update(seen, state)
        out = _see_present(
            asked, now.to_go, now.velocities, seen.last_command, limits, self._acceleration,
            now.lag_s, now.known, shape,
        )  # fmt: skip
        return self._flat(out)

    def _flat(self, channels: FloatArray) -> NDArray[np.float32]:
        """(..., channels, 4) as (..., size)."""
        return channels.reshape(*channels.shape[:-2], self.size).astype(np.float32)

    def to_dict(self) -> dict[str, Any]:
        """The inputs as plain numbers and names, for a manifest."""
        return {"kind": self.kind, "version": VERSION, "names": list(self.names)}

    @classmethod
    def from_dict(
        cls, fields: dict[str, Any], head: HeadModel, layout: ObservationLayout | None = None
    ) -> "Inputs":
        """The inputs that a manifest names.

        Raises:
            ConfigurationError: it names a version or channels that this package does not make.
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


_PRESENT_CHANNELS: Final = len(_Present._fields)
_UNIT = np.ones((2, 2))
_UNLIMITED = np.full(4, 1e9)


@device
def _clip(value: float) -> float:
    return min(max(value, -1.0), 1.0)


@device
def _log(value: float, least: float, most: float) -> float:
    size = min(log1p(abs(value) / least) / log1p(most / least), 1.0)
    return size if value >= 0.0 else -size


@device
def _coasting(v: float, lag: float, a: float) -> float:
    """How far a joint turns until it rests if its command is zero from now on."""
    speed, least = abs(v), a * lag
    turn = speed * lag
    if speed > least:
        # the limit holds the deceleration until the speed is a lag
        turn = (speed * speed - least * least) / (2.0 * a) + least * lag
    return turn if v >= 0.0 else -turn


@device
def _present(
    to_go: float, v: float, u: float, limit: float, a: float, lag: float, known: bool
) -> _Present:
    rest = to_go - _coasting(v, lag, a)
    return _Present(
        to_go=_clip(to_go / COARSE_RAD),
        to_go_log=_log(to_go, LOG_RAD, COARSE_RAD),
        to_go_middle=_clip(to_go / MIDDLE_RAD),
        to_go_fine=_clip(to_go / FINE_RAD),
        to_rest_log=_log(rest, LOG_RAD, COARSE_RAD),
        to_rest_middle=_clip(rest / MIDDLE_RAD),
        to_rest_fine=_clip(rest / FINE_RAD),
        velocity=_clip(v / limit),
        velocity_log=_log(v / limit, LOG_SPEED, 1.0),
        command=_clip(u / limit),
        lag=min(lag / LONGEST_LAG_S, 1.0),
        known=1.0 if known else 0.0,
    )


@kernel(["(f8[:],b1[:],f8[:,:],f8[:,:])"], "(a),(e),(c,a)->(c,a)")
def _see_error(
    asked: FloatArray, visible: NDArray[np.bool_], shape: FloatArray, out: FloatArray
) -> None:
    for j in range(4):
        turn = abs(asked[j])
        error = _Error(
            asked=_clip(turn / COARSE_RAD),
            asked_log=_log(turn, LOG_RAD, COARSE_RAD),
            visible=1.0 if visible[j // 2] else 0.0,
        )
        for c in range(len(error)):
            out[c, j] = error[c]


@kernel(
    ["(f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],b1[:],f8[:,:],f8[:,:])"],
    "(a),(a),(a),(a),(a),(a),(),(e),(c,a)->(c,a)",
)
def _see_present(
    asked: FloatArray, to_go: FloatArray, velocity: FloatArray, command: FloatArray,
    limits: FloatArray, acceleration: FloatArray, lag: FloatArray, known: NDArray[np.bool_],
    shape: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    # with the channels of what is asked for, all counts in the direction in which it is asked
    first = out.shape[0] - _PRESENT_CHANNELS
    for j in range(4):
        side = 1.0
        if first > 0:
            side = 1.0 if asked[j] >= 0.0 else -1.0
            turn, left = side * asked[j], side * to_go[j]
            share = _Share(
                asked=_clip(turn / COARSE_RAD),
                asked_log=_log(turn, LOG_RAD, COARSE_RAD),
                to_go_share=_clip(left / max(turn, LEAST_ASKED_RAD) / MOST_SHARE),
            )
            for c in range(len(share)):
                out[c, j] = share[c]
        present = _present(
            side * to_go[j], side * velocity[j], side * command[j], limits[j], acceleration[j],
            lag[0], known[j // 2],
        )  # fmt: skip
        for c in range(len(present)):
            out[first + c, j] = present[c]
