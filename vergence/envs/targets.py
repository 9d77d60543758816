"""The targets of the gaze task: what moves how, and how a trial begins."""

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from math import cos, hypot, pi, sin, tan
from typing import Any, ClassVar, Final, Literal

import numpy as np

from vergence._jit import compiled, device
from vergence.envs.motion import BEFORE, motion_rows
from vergence.envs.orbits import ATTEMPTS, choose_orbits
from vergence.envs.philox import Purpose, random_words, to_uniform
from vergence.envs.streams import IntArray, Streams
from vergence.errors import ConfigurationError, UnknownNameError
from vergence.models.camera import point_to_pixel
from vergence.models.fixation import fixate_eye
from vergence.models.head import HeadModel
from vergence.models.kinematics import CAMERA_STRIDE, CAMERAS, eye_frames, point_in_eye
from vergence.models.parts import FloatArray

Point = tuple[float, float, float]

_TASK: Final = int(Purpose.TASK)
_ABOVE_ZERO: Final = ("target.period", "target.speed", "target.turns")
_STARTS: Final = 100
_AT_REST: Final = motion_rows(np.zeros(3))


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
    border: float = 0.0
    """Least distance of the target from the images' edges at time zero, px: for true heads that
    do not see quite what their model says."""
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
        rows = np.repeat(_AT_REST, len(ids), axis=0)
        q = np.empty((len(ids), 7))
        limits = head.limits
        found = choose_targets(
            streams.seeds[ids],
            streams.trials[ids],
            head.packed,
            limits.lower,
            limits.upper,
            *self.depth,
            self.eccentricity,
            self.margin,
            self.shift,
            self.border,
            self.start == "fixation",
            rows,
            q,
        )
        if not found:
            raise ConfigurationError(
                f"target: expected a workspace that this head can look at, got none of "
                f"{ATTEMPTS} points of {self} that both eyes can see and fixate"
            )
        return rows, q


@dataclass(frozen=True, kw_only=True)
class OrbitTarget(Target):
    """A target on an ellipse of any place, plane and shape, at the speed that a trial draws.

    Both eyes can fixate the whole ellipse with some degrees to spare, and following it asks
    for at most half of their joints' speed and acceleration. Until time zero the target stands
    at its beginning. Flat ellipses are sweeps back and forth, steep ones are motions in depth.
    """

    kind: ClassVar[str] = "orbit"
    depth: tuple[float, float] = (0.4, 2.5)
    """Nearest and farthest z, m; the centre is uniform in 1 / depth."""
    eccentricity: float = 0.4
    """Greatest angle of the centre from straight ahead, seen from between the eyes, rad."""
    radius: tuple[float, float] = (0.1, 0.35)
    """Least and greatest half of the long axis, as an angle at the centre's depth, rad."""
    speed: tuple[float, float] = (0.3490658503988659, 1.0471975511965976)
    """Range of the greatest angular speed of a trial, seen from between the eyes, rad/s."""
    turns: float = 1.25
    """Most turns per second."""
    margin: float = 0.03490658503988659
    """Least distance of the fixating angles from the joints' limits, rad."""
    start: Literal["rest", "fixation"] = "fixation"

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("depth", "radius", "speed"):
            low, high = getattr(self, name)
            if not 0.0 < low <= high:
                raise ConfigurationError(
                    f"target.{name}: expected 0 < least <= greatest, got {(low, high)}"
                )
        for name, angle in (("eccentricity", self.eccentricity), ("radius", self.radius[1])):
            if not angle < 1.5:
                raise ConfigurationError(f"target.{name}: expected less than 1.5 rad, got {angle}")

    def draw(
        self, head: HeadModel, streams: Streams, ids: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """See `Target.draw`; candidates are drawn until one is fit."""
        rows = np.repeat(_AT_REST, len(ids), axis=0)
        limits = head.limits
        found = choose_orbits(
            streams.seeds[ids],
            streams.trials[ids],
            head.packed,
            limits.lower,
            limits.upper,
            limits.velocity,
            limits.acceleration,
            self.depth,
            self.eccentricity,
            self.radius,
            self.speed,
            self.turns,
            self.margin,
            rows,
        )
        if not found:
            raise ConfigurationError(
                f"target: expected ellipses that this head can follow, got none of "
                f"{ATTEMPTS} of {self}"
            )
        return rows, self._begin(head, rows[:, BEFORE])


@device
def _place(words: Any, cx: float, cy: float, near: float, far: float, eccentricity: float) -> Any:
    """A point of the workspace from three random words."""
    z = 1.0 / (1.0 / far + to_uniform(words[0]) * (1.0 / near - 1.0 / far))
    slope = z * tan(eccentricity * to_uniform(words[1]))
    around = 2.0 * pi * to_uniform(words[2])
    return cx + slope * cos(around), cy + slope * sin(around), z


@device
def _reach(
    p: Any, lower: Any, upper: Any, margin: float, x: float, y: float, z: float, angles: Any
) -> bool:
    """Whether both eyes can fixate a point with a margin, and the eyes' angles."""
    for eye in range(2):
        i, k = 3 + 2 * eye, 2 * eye
        angles[k], angles[k + 1] = fixate_eye(p, eye, x, y, z)
        for j in range(2):
            if not lower[i + j] + margin <= angles[k + j] <= upper[i + j] - margin:
                return False
    return True


@device
def _in_view(p: Any, angles: Any, x: float, y: float, z: float, border: float) -> bool:
    """Whether both eyes see a point at some distance from their images' edges."""
    for eye in range(2):
        k = CAMERAS + eye * CAMERA_STRIDE
        dx, dy, dz = point_in_eye(p, eye, angles[2 * eye], angles[2 * eye + 1], x, y, z)
        u, v = point_to_pixel(p, eye, dx, dy, dz, True)
        if not (border <= u <= p[k + 9] - 1.0 - border and border <= v <= p[k + 10] - 1.0 - border):
            return False
    return True


@device
def _turn(begin: Any, goal: Any) -> Any:
    """The angle that the farther-turning eye turns."""
    left = hypot(goal[0] - begin[0], goal[1] - begin[1])
    return max(left, hypot(goal[2] - begin[2], goal[3] - begin[3]))


@compiled
def choose_targets(
    seeds: Any, trials: Any, p: Any, lower: Any, upper: Any, near: float, far: float,
    eccentricity: float, margin: float, shift: float, border: float, fixating: bool, rows: Any,
    q: Any,
) -> bool:  # fmt: skip
    """Draw candidates for each trial until one is fit.

    Args:
        seeds: (n,) keys of the trials' random numbers.
        trials: (n,) keys of the trials' random numbers.
        p: (PACKED,) the head.
        lower: (7,) its joints' limits, rad.
        upper: (7,) their limits, rad.
        near: see `RandomTarget`, as are the following five.
        far: m.
        eccentricity: rad.
        margin: rad.
        shift: rad.
        border: px.
        fixating: whether the eyes begin on a point of the workspace, or at rest.
        rows: (n, MOTION) result: where the target is, in rows of targets at rest.
        q: (n, 7) result: joint angles at the start, rad.

    Returns:
        False if some trial has no fit candidate.
    """
    rest = np.minimum(np.maximum(lower, 0.0), upper)
    left = eye_frames(p, 0, rest[3], rest[4])[2]
    right = eye_frames(p, 1, rest[5], rest[6])[2]
    cx, cy = 0.5 * (left[3] + right[3]), 0.5 * (left[7] + right[7])
    goal, begin = np.empty(4), np.empty(4)
    for n in range(seeds.shape[0]):
        q[n] = rest
        found = False
        for attempt in range(ATTEMPTS):
            words = random_words(seeds[n], trials[n], _TASK, attempt, 1)
            x, y, z = _place(words, cx, cy, near, far, eccentricity)
            if not _reach(p, lower, upper, margin, x, y, z, goal):
                continue
            # one target, many starts: were both drawn anew, few targets aside would be left,
            # as few of the workspace's points have them in view
            for again in range(_STARTS if fixating else 1):
                words = random_words(seeds[n], trials[n], _TASK, attempt + again, 2)
                bx, by, bz = _place(words, cx, cy, near, far, eccentricity)
                if not fixating:
                    begin[:] = rest[3:]
                elif not _reach(p, lower, upper, margin, bx, by, bz, begin):
                    continue
                if _turn(begin, goal) >= shift and _in_view(p, begin, x, y, z, border):
                    found = True
                    break
            if found:
                break
        if not found:
            return False
        rows[n, 0], rows[n, 1], rows[n, 2] = x, y, z
        rows[n, 3], rows[n, 4], rows[n, 5] = x, y, z
        q[n, 3:] = begin
    return True


TARGETS: Final[dict[str, type[Target]]] = {
    target.kind: target
    for target in (StaticTarget, StepTarget, CircleTarget, LineTarget, RandomTarget, OrbitTarget)
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
    if number < 0.0 or (number == 0.0 and name in _ABOVE_ZERO):
        raise ConfigurationError(f"{name}: expected a number above 0, got {value!r}")
    return number


def _number(name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        raise ConfigurationError(f"{name}: expected a number, got {value!r}")
    number = float(value)
    if not np.isfinite(number):
        raise ConfigurationError(f"{name}: expected a finite number, got {value!r}")
    return number
