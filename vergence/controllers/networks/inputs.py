r"""What a network sees of an observation, and what it remembers.

The observation of `vergence/Gaze-v0` has everything a policy needs, but not in a form that a
small network can use: a gaze settles when the present error is below 1 px, and the present error
is the small difference of large numbers (what an old image shows, and how far the joints have
turned since its exposure). These inputs form that difference with the head's kinematics before
the network sees it. Four kinds exist, see `KINDS`; `error` and `observation` leave the
difference out and serve to show what it brings.

All but `observation` speak of the actuators that move the eyes: each channel exists for every one
of them. Where each of the four eye joints has a motor of its own, one small network can serve
all of them (`Inputs.by_joint`). Every channel lies in [-1, 1]. Angles and velocities come in
several resolutions: linear channels that saturate, and a logarithmic one,

    sign(x) ln(1 + |x| / x0) / ln(1 + x_max / x0)

which resolves every size of a quantity by the same share.

The numbers are part of the contract between a training run and its bundle: `Inputs.to_dict` goes
into the manifest, and `VERSION` grows with every change of what a channel means.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.controllers.ibvs import servo
from vergence.controllers.networks.channels import CHANNELS, see_error, see_present
from vergence.controllers.prediction.joints import eyes_moved
from vergence.controllers.prediction.predictor import Predictor
from vergence.envs.encoding import FIELDS, as_observation
from vergence.envs.layout import ObservationLayout
from vergence.errors import ConfigurationError, UnknownNameError
from vergence.models.head import HeadModel
from vergence.models.joints import EYES, JOINTS
from vergence.models.parts import FloatArray

VERSION: Final = 1
"""Version of what the channels mean."""

KINDS: Final[dict[str, tuple[str, ...]]] = {
    "observation": tuple(
        f"{name}_{i}" for name, part in FIELDS.items() for i in range(part.stop - part.start)
    ),
    **{
        kind: tuple(f"{channel}_{joint}" for channel in channels for joint in JOINTS[EYES])
        for kind, channels in CHANNELS.items()
    },
}
"""The names of all numbers of each kind, in their order, for the article's four eye joints; for any
head see `names_of`. `observation` is that of the task."""


def names_of(kind: str, layout: ObservationLayout) -> tuple[str, ...]:
    """The names of all numbers of a kind of inputs, in their order.

    Args:
        kind: one of `KINDS`.
        layout: the layout of observations, which knows the actuators.

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
        self.names = names_of(kind, layout)
        self.kind = kind
        self.head = head
        self.layout = layout
        self._predictor = (
            Predictor(head=head, layout=layout) if kind in ("predicted", "to_go") else None
        )
        actuation = head.actuation
        self._acceleration = np.array(actuation.acceleration[EYES])
        self._lag_ratio = np.array(actuation.lag_ratio[EYES])
        self._moved = eyes_moved(head).T

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
        """(4, channels) where each joint's own numbers are.

        None for `observation`, and for a head whose eye joints do not each have their own motor.
        """
        if self.kind == "observation" or not self.head.actuation.direct:
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
            observation: (..., n) observations of the gaze task.
            state: (..., state_size) what is remembered; brought up to date in place.

        Returns:
            (..., size) inputs in [-1, 1].
        """
        if self.kind == "observation":
            return np.array(as_observation(observation, self.layout.size), dtype=np.float32)
        seen = self.layout.decode(observation)
        limits, shape = self.layout.action_limits, np.empty((len(CHANNELS[self.kind]), 4))
        asked = servo(
            self.head,
            seen.positions_at_exposure,
            seen.pixel_error,
            _UNIT,
            np.nan,
            _UNLIMITED,
        )
        if self._predictor is None:
            return self._flat(see_error(asked, seen.visible @ self._moved, shape))
        now = self._predictor.update(seen, state)
        out = see_present(
            asked, now.to_go, now.velocities, seen.last_command, limits, self._acceleration,
            now.lag_s[..., None] * self._lag_ratio, now.known @ self._moved, shape,
        )  # fmt: skip
        return self._flat(out)

    def _flat(self, channels: FloatArray) -> NDArray[np.float32]:
        """(..., channels, 4) as (..., size): those of the actuators that there are."""
        channels = channels[..., : self.layout.count]
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


_UNIT = np.ones((2, 2))
_UNLIMITED = np.full(4, 1e9)
