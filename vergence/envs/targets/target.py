"""What every target of the gaze task is: a motion and a start for each trial."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Final, Literal

import numpy as np

from vergence.envs.fields import numbers
from vergence.envs.streams import IntArray, Streams
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

_ABOVE_ZERO: Final = ("period", "speed", "turns")


@dataclass(frozen=True, kw_only=True)
class Target(ABC):
    """A kind of target: draws the motion and the start of each trial from the trial's stream."""

    kind: ClassVar[str]

    start: Literal["rest", "fixation"] = "rest"
    """Where the eyes are at time zero: at rest, or fixating where the target is (or was)."""

    def __post_init__(self) -> None:
        if self.start not in ("rest", "fixation"):
            raise ConfigurationError(
                f"target.start: expected 'rest' or 'fixation', got {self.start!r}"
            )
        for name, value in vars(self).items():
            if name != "start":
                default = getattr(type(self), name)
                size = len(default) if isinstance(default, tuple) else 0
                checked = numbers(f"target.{name}", value, size, name in _ABOVE_ZERO)
                object.__setattr__(self, name, checked)

    @abstractmethod
    def draw(
        self, head: HeadModel, streams: Streams, ids: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """Draw the trials of some places.

        Args:
            head: the model of the head, one head.
            streams: the trials' random streams.
            ids: (n,) the places.

        Returns:
            (n, MOTION) motions and (n, 7) joint angles at the start, rad.
        """

    def _begin(self, head: HeadModel, fixated: FloatArray) -> FloatArray:
        if self.start == "rest":
            return np.broadcast_to(head.rest(), (len(fixated), 7)).copy()
        q = head.fixate(fixated, head.rest()[:3])
        if not head.limits.contains(q).all():
            bad = fixated[np.flatnonzero(~head.limits.contains(q))[0]]
            raise ConfigurationError(
                f"target: expected a start that both eyes can fixate, got {bad} m"
            )
        return q
