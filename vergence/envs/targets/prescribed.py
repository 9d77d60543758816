"""Targets with the same motion in every trial: at rest, a jump, a circle, a line."""

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from vergence.envs.streams import IntArray, RandomStreams
from vergence.envs.targets.motion import (
    POINT,
    Board,
    Target,
    fixation_angles,
    motion_rows,
    require_seen_by_an_eye,
)
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

Point = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class PrescribedTarget(Target):
    """A target without randomness: one motion for all trials."""

    first_point_name: ClassVar[str]
    """Name of its position at time zero, for error messages."""
    stays_at_first_point: ClassVar[bool] = False
    """True if it stays at this position."""

    @abstractmethod
    def _trial(self) -> tuple[ArrayLike, ArrayLike, FloatArray]:
        """(3,) points in N, m, and (1, MOTION) row of the motion, see `motion_rows`.

        The eyes fixate the first point for `start="fixation"`; at time zero the target is at the
        second.
        """

    def check(self, head: HeadModel) -> None:
        """See `Target.check`: an eye must see the first point, both must reach a lasting one."""
        fixated, first_point, _rows = self._trial()
        (q,), first = self._begin(head, np.array([fixated])), np.array(first_point)
        require_seen_by_an_eye(head, self.first_point_name, first, q)
        if self.stays_at_first_point:
            fixation_angles(head, self.first_point_name, first[None])

    def draw(
        self, head: HeadModel, streams: RandomStreams, ids: IntArray, board: Board = POINT
    ) -> tuple[FloatArray, FloatArray]:
        """See `Target.draw`."""
        fixated, _first, rows = self._trial()
        held = np.broadcast_to(fixated, (len(ids), 3))
        return np.repeat(rows, len(ids), axis=0), self._begin(head, held)


@dataclass(frozen=True, kw_only=True)
class StaticTarget(PrescribedTarget):
    """A target that appears at time zero and stays."""

    kind: ClassVar[str] = "static"
    length_fields: ClassVar[tuple[str, ...]] = ("point",)
    first_point_name: ClassVar[str] = "point"
    stays_at_first_point: ClassVar[bool] = True
    point: Point = (0.0, -0.1, 1.0)
    """Position in N, m."""

    def _trial(self) -> tuple[ArrayLike, ArrayLike, FloatArray]:
        return self.point, self.point, motion_rows(self.point)


@dataclass(frozen=True, kw_only=True)
class UnseenTarget(StaticTarget):
    """A place that is looked at without images: it may be out of view at first."""

    def check(self, head: HeadModel) -> None:
        """See `Target.check`: both eyes must reach it."""
        fixation_angles(head, self.first_point_name, np.array([self.point]))


@dataclass(frozen=True, kw_only=True)
class StepTarget(PrescribedTarget):
    """A target that both eyes fixate until it jumps at time zero: the article's gain sweep."""

    kind: ClassVar[str] = "step"
    length_fields: ClassVar[tuple[str, ...]] = ("before", "after")
    first_point_name: ClassVar[str] = "point after the step"
    stays_at_first_point: ClassVar[bool] = True
    before: Point = (0.0, -0.1, 1.0)
    """Position before the jump, in N, m."""
    after: Point = (0.0, -0.2, 1.0)
    """Position after the jump, in N, m."""
    start: Literal["rest", "fixation"] = "fixation"

    def _trial(self) -> tuple[ArrayLike, ArrayLike, FloatArray]:
        return self.before, self.after, motion_rows(self.after, before=[self.before])


@dataclass(frozen=True, kw_only=True)
class CircleTarget(PrescribedTarget):
    """A target on a circle in a plane of constant depth: `x = r sin(wt)`, `y = r cos(wt)`."""

    kind: ClassVar[str] = "circle"
    length_fields: ClassVar[tuple[str, ...]] = ("centre", "radius")
    first_point_name: ClassVar[str] = "beginning of the circle"
    centre: Point = (0.0, -0.1, 1.0)
    """Centre of the circle, in N, m."""
    radius: float = 0.1
    """Radius of the circle, m."""
    period: float = 62.83185307179586
    """Duration of a turn, s."""
    start: Literal["rest", "fixation"] = "fixation"

    def _trial(self) -> tuple[ArrayLike, ArrayLike, FloatArray]:
        x, y, z = self.centre
        first, omega = (x, y + self.radius, z), 2.0 * np.pi / self.period
        cosine, sine = (0.0, self.radius, 0.0), (self.radius, 0.0, 0.0)
        rows = motion_rows(self.centre, before=[first], cosine=cosine, sine=sine, omega=omega)
        return first, first, rows


@dataclass(frozen=True, kw_only=True)
class LineTarget(PrescribedTarget):
    """A target that moves along a line at constant speed and stops at its end."""

    kind: ClassVar[str] = "line"
    length_fields: ClassVar[tuple[str, ...]] = ("origin", "end", "speed")
    first_point_name: ClassVar[str] = "beginning of the line"
    origin: Point = (-0.27860, -0.02313, 0.95784)
    """Start of the line, in N, m."""
    end: Point = (-0.39002, -0.03039, 1.11191)
    """End of the line, in N, m."""
    speed: float = 0.01
    """Speed along the line, m/s."""
    start: Literal["rest", "fixation"] = "fixation"

    def _trial(self) -> tuple[ArrayLike, ArrayLike, FloatArray]:
        path = np.subtract(self.end, self.origin)
        length = float(np.linalg.norm(path))
        velocity = path * (self.speed / length) if length > 0.0 else np.zeros(3)
        origin, duration = [self.origin], length / self.speed
        rows = motion_rows(origin, before=origin, velocity=velocity, duration=duration)
        return self.origin, self.origin, rows
