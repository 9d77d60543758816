"""What every target of the gaze task is: a motion and a start for each trial."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Final, Literal

import numpy as np
from numpy.typing import NDArray

from vergence.envs.fields import numbers
from vergence.envs.streams import IntArray, Streams
from vergence.envs.targets.board import POINT, Board
from vergence.errors import ConfigurationError, TargetError
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

_ABOVE_ZERO: Final = ("period", "speed", "turns", "gone_s")
FARTHEST_M: Final = 100.0
"""What every length of a target is less than, m: no robot's eyes look so far, and a person who
takes millimetres for metres writes at least this."""


@dataclass(frozen=True, kw_only=True)
class Target(ABC):
    """A kind of target: draws the motion and the start of each trial from the trial's stream."""

    kind: ClassVar[str]
    anywhere: ClassVar[bool] = False
    """Whether trials draw it anywhere in a workspace, near and far."""
    metres: ClassVar[tuple[str, ...]] = ()
    """The fields that are lengths or coordinates."""

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
                if name in self.metres and not np.abs(np.array(checked)).max() < FARTHEST_M:
                    raise ConfigurationError(
                        f"target.{name}: expected metres below {FARTHEST_M:g} in size (is it in "
                        "millimetres? Python takes metres, only the command line takes "
                        f"millimetres), got {value!r}"
                    )
                object.__setattr__(self, name, checked)

    def _refuse_unordered(self, *names: str) -> None:
        """Refuse fields that are no ranges of numbers above zero."""
        for name in names:
            low, high = getattr(self, name)
            if not 0.0 < low <= high:
                raise ConfigurationError(
                    f"target.{name}: expected 0 < least <= greatest, got {(low, high)}"
                )

    def check(self, head: HeadModel) -> None:
        """Refuse what these eyes could never find or reach, whatever the trial.

        Args:
            head: the model of the head that has to look.

        Raises:
            ConfigurationError: the eyes cannot.
        """

    @abstractmethod
    def draw(
        self, head: HeadModel, streams: Streams, ids: IntArray, board: Board = POINT
    ) -> tuple[FloatArray, FloatArray]:
        """Draw the trials of some places.

        Args:
            head: the model of the head, one head.
            streams: the trials' random streams.
            ids: (n,) the places.
            board: what the target looks like to the eyes.

        Returns:
            (n, MOTION or more) motions and (n, 7) joint angles at the start, rad.
        """

    def _begin(self, head: HeadModel, fixated: FloatArray) -> FloatArray:
        if self.start == "rest":
            return np.broadcast_to(head.rest(), (len(fixated), 7)).copy()
        return fixating(head, "start", fixated)


def fixating(head: HeadModel, what: str, points: FloatArray) -> FloatArray:
    """The joint angles that put points on both optical axes, or as near as actuators can.

    Args:
        head: the model of the head.
        what: what a message calls the points, such as `point`.
        points: (n, 3) in N, m.

    Returns:
        (n, 7) rad.

    Raises:
        ConfigurationError: the limits do not let both eyes look at a point.
    """
    q = head.fixate(points, head.rest()[:3])
    within = head.reaches(q)
    asked = "fixate within their joints' limits"
    if not head.actuation.direct:
        # the best that tied joints can do may still have a point outside the images
        within &= _in_images(head, q, points).all(axis=-1)
        asked = "look at within their limits, and see then"
    if not within.all():
        bad = tuple(points[np.flatnonzero(~within)[0]].tolist())
        raise TargetError(f"target: expected a {what} that both eyes can {asked}, got {bad} m")
    return q


def _in_images(head: HeadModel, q: FloatArray, points: FloatArray) -> NDArray[np.bool_]:
    """(..., 2) whether points lie inside each eye's image."""
    pixels = head.project(q, points)
    inside = (pixels >= -0.5) & (pixels <= head.cameras.size - 0.5)
    return np.asarray(inside.all(axis=-1))


def refuse_unseen(head: HeadModel, what: str, point: FloatArray, q: FloatArray) -> None:
    """Refuse a point that neither eye has in view, as nothing could ever find it.

    Args:
        head: the model of the head.
        what: what a message calls the point.
        point: (3,) in N, m.
        q: (7,) joint angles at the start, rad.

    Raises:
        ConfigurationError: neither eye sees it.
    """
    if _in_images(head, q, point).any():
        return
    where = "outside both images"
    if not np.isfinite(head.project(q, point)).any():
        where = "behind the head or far outside both images"
    raise TargetError(
        f"target: expected a {what} that an eye sees at the start of the trial, got "
        f"{tuple(point.tolist())} m, which is {where}"
    )
