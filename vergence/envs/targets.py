"""The targets of the gaze task: what moves how, and how a trial begins."""

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from math import cos, hypot, pi, sin, tan
from typing import Any, ClassVar, Final, Literal

import numpy as np

from vergence._jit import compiled, device
from vergence.envs.motion import motion_rows
from vergence.envs.streams import IntArray, Purpose, Streams
from vergence.errors import ConfigurationError, UnknownNameError
from vergence.models.camera import point_to_pixel
from vergence.models.fixation import fixate_eye
from vergence.models.head import HeadModel
from vergence.models.kinematics import CAMERA_STRIDE, CAMERAS, point_in_eye
from vergence.models.parts import FloatArray

Point = tuple[float, float, float]


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
                object.__setattr__(self, name, _numbers(f"target.{name}", value, size))

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


@dataclass(frozen=True, kw_only=True)
class RandomTarget(Target):
    """A target that appears anywhere in a workspace, uniform in eccentricity and in 1 / depth.

    Both eyes can fixate it with some degrees to spare, both see it at time zero, and the
    eyes have to turn by a least angle. With `start="fixation"` the eyes begin on another
    point of the workspace.
    """

    kind: ClassVar[str] = "random"
    depth: tuple[float, float] = (0.3, 2.5)
    """Nearest and farthest z, m."""
    eccentricity: float = 0.7
    """Greatest angle from straight ahead, seen from between the eyes, rad."""
    margin: float = 0.03490658503988659
    """Least distance of the fixating angles from the joints' limits, rad."""
    shift: float = 0.03490658503988659
    """Least angle that the farther-turning eye has to turn, rad."""
    start: Literal["rest", "fixation"] = "fixation"

    def __post_init__(self) -> None:
        super().__post_init__()
        near, far = self.depth
        if not 0.0 < near <= far:
            raise ConfigurationError(
                f"target.depth: expected 0 < nearest <= farthest, got {self.depth}"
            )
        if not 0.0 < self.eccentricity < 1.5:
            raise ConfigurationError(
                f"target.eccentricity: expected 0 to 1.5 rad, got {self.eccentricity}"
            )

    def draw(
        self, head: HeadModel, streams: Streams, ids: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """See `Target.draw`; candidates are drawn until one is fit."""
        points = np.empty((len(ids), 3))
        q = np.broadcast_to(head.rest(), (len(ids), 7)).copy()
        fit = np.zeros(len(ids), dtype=np.bool_)
        centre = head.camera_poses(head.rest())[:, :2, 3].mean(axis=0)
        pending = np.arange(len(ids))
        for block in range(_BLOCKS):
            numbers = streams.uniform(ids[pending], Purpose.TASK, block, 6 * _CANDIDATES)
            choose_targets(
                pending,
                numbers.reshape(-1, _CANDIDATES, 6),
                head.packed,
                head.limits.lower + self.margin,
                head.limits.upper - self.margin,
                centre,
                *self.depth,
                self.eccentricity,
                self.shift,
                self.start == "fixation",
                points,
                q,
                fit,
            )
            pending = pending[~fit[pending]]
            if not pending.size:
                return motion_rows(points), q
        raise ConfigurationError(
            f"target: expected a workspace that this head can look at, got none of "
            f"{_BLOCKS * _CANDIDATES} points of {self} that both eyes can see and fixate"
        )


@device
def _place(numbers: Any, centre: Any, near: float, far: float, eccentricity: float) -> Any:
    """A point of the workspace from three numbers from 0 to 1."""
    z = 1.0 / (1.0 / far + numbers[0] * (1.0 / near - 1.0 / far))
    slope, around = z * tan(eccentricity * numbers[1]), 2.0 * pi * numbers[2]
    return centre[0] + slope * cos(around), centre[1] + slope * sin(around), z


@compiled
def choose_targets(
    places: Any, numbers: Any, p: Any, lower: Any, upper: Any, centre: Any, near: float,
    far: float, eccentricity: float, shift: float, fixating: bool, points: Any, q: Any,
    fit: Any,
) -> None:  # fmt: skip
    """Take each trial's first candidate that is fit.

    Args:
        places: (m,) rows of the results.
        numbers: (m, candidates, 6) numbers from 0 to 1.
        p: (PACKED,) the head.
        lower: (7,) the least angles that are fit, rad.
        upper: (7,) the greatest, rad.
        centre: (2,) x and y of the middle between the eyes, m.
        near: see `RandomTarget`, as are the following three.
        far: m.
        eccentricity: rad.
        shift: rad.
        fixating: whether the eyes begin on a point of the workspace, or as `q` says.
        points: (n, 3) result, m.
        q: (n, 7) joint angles at the start, rad: in, and out where the eyes begin on a point.
        fit: (n,) result: whether there was a fit candidate.
    """
    begin = np.empty(4)
    for row in range(places.shape[0]):
        n = places[row]
        for candidate in numbers[row]:
            x, y, z = _place(candidate[:3], centre, near, far, eccentricity)
            bx, by, bz = _place(candidate[3:], centre, near, far, eccentricity)
            turn, fits = 0.0, True
            for eye in range(2):
                i = 3 + 2 * eye
                tilt, pan = q[n, i], q[n, i + 1]
                if fixating:
                    tilt, pan = fixate_eye(p, eye, bx, by, bz)
                k = CAMERAS + eye * CAMERA_STRIDE
                u, v = point_to_pixel(p, eye, *point_in_eye(p, eye, tilt, pan, x, y, z), True)
                fits = fits and 0.0 <= u <= p[k + 9] - 1.0 and 0.0 <= v <= p[k + 10] - 1.0
                fits = fits and lower[i] <= tilt <= upper[i]
                fits = fits and lower[i + 1] <= pan <= upper[i + 1]
                if not fits:
                    break
                to_tilt, to_pan = fixate_eye(p, eye, x, y, z)
                fits = lower[i] <= to_tilt <= upper[i] and lower[i + 1] <= to_pan <= upper[i + 1]
                turn = max(turn, hypot(to_tilt - tilt, to_pan - pan))
                begin[i - 3], begin[i - 2] = tilt, pan
            if fits and turn >= shift:
                points[n, 0], points[n, 1], points[n, 2] = x, y, z
                q[n, 3:] = begin
                fit[n] = True
                break


_CANDIDATES: Final = 8
_BLOCKS: Final = 200

TARGETS: Final[dict[str, type[Target]]] = {
    target.kind: target
    for target in (StaticTarget, StepTarget, CircleTarget, LineTarget, RandomTarget)
}
"""The kinds of target by name."""


def make_target(target: "str | Mapping[str, Any] | Target") -> Target:
    """Make a target from its name, or from a mapping of its fields with its `kind`.

    Args:
        target: `"random"`, `{"kind": "static", "point": [0, -0.1, 1]}`, or a target.

    Returns:
        The target.

    Raises:
        UnknownNameError: there is no such kind.
        ConfigurationError: a field is unknown or has a value that cannot be.
    """
    if isinstance(target, Target):
        return target
    fields = dict(target) if isinstance(target, Mapping) else {"kind": target}
    kind = fields.pop("kind", None)
    if not isinstance(kind, str) or kind not in TARGETS:
        raise UnknownNameError("target", kind, sorted(TARGETS))
    known = {field.name for field in dataclasses.fields(TARGETS[kind])}
    for name, value in fields.items():
        if name not in known:
            raise ConfigurationError(
                f"target.{name}: expected one of {', '.join(sorted(known))}, "
                f"got {name!r} = {value!r}"
            )
    return TARGETS[kind](**fields)


def _numbers(name: str, value: object, size: int) -> object:
    """A tuple of finite numbers, or one if size is 0; every length, time and speed is positive."""
    if size:
        if not isinstance(value, list | tuple | np.ndarray) or len(value) != size:
            raise ConfigurationError(f"{name}: expected {size} numbers, got {value!r}")
        return tuple(_number(name, item) for item in value)
    number = _number(name, value)
    if number < 0.0 or (number == 0.0 and name in ("target.period", "target.speed")):
        raise ConfigurationError(f"{name}: expected a number above 0, got {value!r}")
    return number


def _number(name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        raise ConfigurationError(f"{name}: expected a number, got {value!r}")
    number = float(value)
    if not np.isfinite(number):
        raise ConfigurationError(f"{name}: expected a finite number, got {value!r}")
    return number
