"""Targets that do the same in every trial: at rest, a jump, a circle, a line."""

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from vergence.envs.streams import IntArray, Streams
from vergence.envs.targets.motion import motion_rows
from vergence.envs.targets.target import Target
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

Point = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class StaticTarget(Target):
    """A target that appears at time zero and stays."""

    kind: ClassVar[str] = "static"
    point: Point = (0.0, -0.1, 1.0)
    """Where, in N, m."""

    def draw(
        self, head: HeadModel, streams: Streams, ids: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """See `Target.draw`."""
        points = np.broadcast_to(self.point, (len(ids), 3))
        return motion_rows(points), self._begin(head, points)


@dataclass(frozen=True, kw_only=True)
class StepTarget(Target):
    """A target that both eyes hold until it jumps at time zero: the article's gain sweep."""

    kind: ClassVar[str] = "step"
    before: Point = (0.0, -0.1, 1.0)
    """Where it was, in N, m."""
    after: Point = (0.0, -0.2, 1.0)
    """Where it jumps to, in N, m."""
    start: Literal["rest", "fixation"] = "fixation"

    def draw(
        self, head: HeadModel, streams: Streams, ids: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """See `Target.draw`."""
        before = np.broadcast_to(self.before, (len(ids), 3))
        after = np.broadcast_to(self.after, (len(ids), 3))
        return motion_rows(after, before=before), self._begin(head, before)


@dataclass(frozen=True, kw_only=True)
class CircleTarget(Target):
    """A target on a circle in a plane of constant depth: `x = r sin(wt)`, `y = r cos(wt)`."""

    kind: ClassVar[str] = "circle"
    centre: Point = (0.0, -0.1, 1.0)
    """The circle's centre, in N, m."""
    radius: float = 0.1
    """Its radius, m."""
    period: float = 62.83185307179586
    """Time of a turn, s."""
    start: Literal["rest", "fixation"] = "fixation"

    def draw(
        self, head: HeadModel, streams: Streams, ids: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """See `Target.draw`."""
        centre = np.broadcast_to(self.centre, (len(ids), 3))
        cosine, sine = np.array([0.0, self.radius, 0.0]), np.array([self.radius, 0.0, 0.0])
        before = centre + cosine
        rows = motion_rows(
            centre, before=before, cosine=cosine, sine=sine, omega=2.0 * np.pi / self.period
        )
        return rows, self._begin(head, before)


@dataclass(frozen=True, kw_only=True)
class LineTarget(Target):
    """A target that moves along a line at constant speed and stops at its end."""

    kind: ClassVar[str] = "line"
    origin: Point = (-0.27860, -0.02313, 0.95784)
    """Where it begins, in N, m."""
    end: Point = (-0.39002, -0.03039, 1.11191)
    """Where it ends, in N, m."""
    speed: float = 0.01
    """m/s."""
    start: Literal["rest", "fixation"] = "fixation"

    def draw(
        self, head: HeadModel, streams: Streams, ids: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """See `Target.draw`."""
        origin = np.broadcast_to(self.origin, (len(ids), 3))
        path = np.subtract(self.end, self.origin)
        length = float(np.linalg.norm(path))
        velocity = path * (self.speed / length) if length > 0.0 else np.zeros(3)
        duration = length / self.speed
        rows = motion_rows(origin, before=origin, velocity=velocity, duration=duration)
        return rows, self._begin(head, origin)
