"""Base class of the gaze task's targets: a motion and a start for each trial."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Final, Literal

import numpy as np
from numpy.typing import NDArray

from vergence.envs.streams import IntArray, RandomStreams
from vergence.envs.targets.board import POINT, Board
from vergence.envs.validation import check_tuple_or_nonnegative
from vergence.errors import ConfigurationError, UnreachableTargetError
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

_POSITIVE_FIELDS: Final = ("period", "speed", "turns", "gone_s")
MAX_LENGTH_M: Final = 100.0
"""Upper limit of every length of a target, m (chosen: farther than any robot's eyes look, yet low
enough to catch most values in millimetres)."""


@dataclass(frozen=True, kw_only=True)
class Target(ABC):
    """A kind of target: draws the motion and the start of each trial from the trial's stream."""

    kind: ClassVar[str]
    drawn_in_workspace: ClassVar[bool] = False
    """True if each trial draws a position in a workspace, so that `Plant.workspace_options`
    apply."""
    length_fields: ClassVar[tuple[str, ...]] = ()
    """Names of the fields that are lengths or coordinates."""

    start: Literal["rest", "fixation"] = "rest"
    """Gaze at time zero: at rest, or fixating the target where it is (or was)."""

    def __post_init__(self) -> None:
        if self.start not in ("rest", "fixation"):
            raise ConfigurationError(
                f"target.start: expected 'rest' or 'fixation', got {self.start!r}"
            )
        for name, value in vars(self).items():
            if name != "start":
                default = getattr(type(self), name)
                size = len(default) if isinstance(default, tuple) else 0
                checked = check_tuple_or_nonnegative(
                    f"target.{name}", value, size, name in _POSITIVE_FIELDS
                )
                if (
                    name in self.length_fields
                    and not np.abs(np.array(checked)).max() < MAX_LENGTH_M
                ):
                    raise ConfigurationError(
                        f"target.{name}: expected metres below {MAX_LENGTH_M:g} in size (is it in "
                        "millimetres? Python takes metres, only the command line takes "
                        f"millimetres), got {value!r}"
                    )
                object.__setattr__(self, name, checked)

    def _refuse_unordered(self, *names: str) -> None:
        """Refuse fields that are not ranges of numbers above zero."""
        for name in names:
            low, high = getattr(self, name)
            if not 0.0 < low <= high:
                raise ConfigurationError(
                    f"target.{name}: expected 0 < least <= greatest, got {(low, high)}"
                )

    def check(self, head: HeadModel) -> None:
        """Refuse a target that a head's eyes could not find or reach in any trial.

        Args:
            head: the model of the head that looks.

        Raises:
            ConfigurationError: the eyes cannot find or reach it.
        """

    @abstractmethod
    def draw(
        self, head: HeadModel, streams: RandomStreams, ids: IntArray, board: Board = POINT
    ) -> tuple[FloatArray, FloatArray]:
        """Draw motions and starts for the trials of some environments.

        Args:
            head: the model of the head, one head.
            streams: the trials' random streams.
            ids: (n,) environment indices.
            board: shape of the target.

        Returns:
            (n, MOTION or more) motions and (n, 7) joint angles at the start, rad.
        """

    def _begin(self, head: HeadModel, fixated: FloatArray) -> FloatArray:
        if self.start == "rest":
            return np.broadcast_to(head.rest(), (len(fixated), 7)).copy()
        return fixation_angles(head, "start", fixated)


def fixation_angles(head: HeadModel, point_name: str, points: FloatArray) -> FloatArray:
    """Compute joint angles that put points on both optical axes, or as near as actuators can.

    Args:
        head: the model of the head.
        point_name: name of the points for error messages, such as `point`.
        points: (n, 3) in N, m.

    Returns:
        (n, 7) rad.

    Raises:
        ConfigurationError: the limits prevent both eyes from looking at a point.
    """
    q = head.fixate(points, head.rest()[:3])
    within = head.reaches(q)
    asked = "fixate within their joints' limits"
    if not head.actuation.direct:
        # even the best gaze of coupled joints may leave a point outside the images
        within &= _in_images(head, q, points).all(axis=-1)
        asked = "look at within their limits, and see then"
    if not within.all():
        bad = tuple(points[np.flatnonzero(~within)[0]].tolist())
        raise UnreachableTargetError(
            f"target: expected a {point_name} that both eyes can {asked}, got {bad} m"
        )
    return q


def _in_images(head: HeadModel, q: FloatArray, points: FloatArray) -> NDArray[np.bool_]:
    """(..., 2) True if a point lies inside the eye's image."""
    pixels = head.project(q, points)
    inside = (pixels >= -0.5) & (pixels <= head.cameras.size - 0.5)
    return np.asarray(inside.all(axis=-1))


def require_seen_by_an_eye(
    head: HeadModel, point_name: str, point: FloatArray, q: FloatArray
) -> None:
    """Refuse a point that neither eye sees, as no controller could ever find it.

    Args:
        head: the model of the head.
        point_name: name of the point for error messages.
        point: (3,) in N, m.
        q: (7,) joint angles at the start, rad.

    Raises:
        UnreachableTargetError: neither eye sees it.
    """
    if _in_images(head, q, point).any():
        return
    where = "outside both images"
    if not np.isfinite(head.project(q, point)).any():
        where = "behind the head or far outside both images"
    raise UnreachableTargetError(
        f"target: expected a {point_name} that an eye sees at the start of the trial, got "
        f"{tuple(point.tolist())} m, which is {where}"
    )
