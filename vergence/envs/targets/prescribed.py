"""Targets with the same motion in every trial: at rest, a jump, a circle, a line."""

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

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
    def _motion(self) -> FloatArray:
        """(1, MOTION) row of the motion, see `motion_rows`."""

    @abstractmethod
    def _fixated_point(self) -> Point | FloatArray:
        """(3,) point that the eyes fixate at time zero for `start="fixation"`, in N, m."""

    def _first_point(self) -> Point | FloatArray:
        """(3,) position of the target at time zero, in N, m."""
        return self._fixated_point()

    def check(self, head: HeadModel) -> None:
        """See `Target.check`: an eye must see the first point, both must reach a lasting one."""
        (q,) = self._begin(head, np.array([self._fixated_point()]))
        first = np.array(self._first_point())
        require_seen_by_an_eye(head, self.first_point_name, first, q)
        if self.stays_at_first_point:
            fixation_angles(head, self.first_point_name, first[None])

    def draw(
        self, head: HeadModel, streams: RandomStreams, ids: IntArray, board: Board = POINT
    ) -> tuple[FloatArray, FloatArray]:
        """See `Target.draw`."""
        held = np.broadcast_to(self._fixated_point(), (len(ids), 3))
        return np.repeat(self._motion(), len(ids), axis=0), self._begin(head, held)


@dataclass(frozen=True, kw_only=True)
class StaticTarget(PrescribedTarget):
    """A target that appears at time zero and stays."""

    kind: ClassVar[str] = "static"
    length_fields: ClassVar[tuple[str, ...]] = ("point",)
    first_point_name: ClassVar[str] = "point"
    stays_at_first_point: ClassVar[bool] = True
    point: Point = (0.0, -0.1, 1.0)
    """Position in N, m."""

    def _fixated_point(self) -> Point:
        return self.point

    def _motion(self) -> FloatArray:
        return motion_rows(self.point)


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

    def _fixated_point(self) -> Point:
        return self.before

    def _first_point(self) -> Point:
        return self.after

    def _motion(self) -> FloatArray:
        return motion_rows(self.after, before=np.array([self.before]))


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

    def _fixated_point(self) -> FloatArray:
        x, y, z = self.centre
        return np.array([x, y + self.radius, z])

    def _motion(self) -> FloatArray:
        cosine, sine = np.array([0.0, self.radius, 0.0]), np.array([self.radius, 0.0, 0.0])
        return motion_rows(
            self.centre, before=self._fixated_point()[None], cosine=cosine, sine=sine,
            omega=2.0 * np.pi / self.period,
        )  # fmt: skip


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

    def _fixated_point(self) -> Point:
        return self.origin

    def _motion(self) -> FloatArray:
        path = np.subtract(self.end, self.origin)
        length = float(np.linalg.norm(path))
        velocity = path * (self.speed / length) if length > 0.0 else np.zeros(3)
        origin = np.array([self.origin])
        return motion_rows(origin, before=origin, velocity=velocity, duration=length / self.speed)
