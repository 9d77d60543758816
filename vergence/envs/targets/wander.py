"""A target that wanders through a workspace and turns when nobody expects it."""

from dataclasses import dataclass
from math import cos, hypot, pi, sin, sqrt, tan
from typing import ClassVar, Final, Literal, NamedTuple

import numpy as np

from vergence._jit import bare, compiled, device, subroutine
from vergence.envs.streams import IntArray, Keys, Purpose, Streams, Words, random_words, to_uniform
from vergence.envs.targets.board import POINT, Board, in_view, wholly
from vergence.envs.targets.motion import motion_rows
from vergence.envs.targets.path import on_stretch
from vergence.envs.targets.placement import ATTEMPTS, Gaze, between, between_eyes, can_fixate, place
from vergence.envs.targets.target import Target
from vergence.errors import ConfigurationError, TargetError
from vergence.models.actuation import SLOTS
from vergence.models.head import HeadModel
from vergence.models.packed import actuator_at, is_direct
from vergence.models.parts import FloatArray
from vergence.models.pose import Vector

_TASK: Final = int(Purpose.TASK)
_STRETCHES: Final = 32
_TURNS: Final = 50
_SAMPLES: Final = 4
# what a target asks of an actuator leaves the other half for catching up with it
_SHARE_OF_SPEED: Final = 0.5


@dataclass(frozen=True, kw_only=True)
class WanderTarget(Target):
    """A random walk: straight on for a while, then on in another direction, near and far.

    Seen from between the eyes the target moves with one angular speed, which the trial draws, and
    with a rate of 1 / distance that is drawn anew at each turn, as are the direction (uniform) and
    the time until the next. A stretch that would lead out of the workspace, or anywhere where an
    eye cannot fixate it with some degrees to spare or then see the whole board, where the plant
    shows one, is drawn anew. Following it asks for at most half of the actuators' speed, but at
    its turns for acceleration without end: that is what it is for, as no eye can stay on it
    there. Until time zero it stands at its beginning. After 32 stretches it goes
    back along its way, and so never ends.
    """

    kind: ClassVar[str] = "wander"
    anywhere: ClassVar[bool] = True
    metres: ClassVar[tuple[str, ...]] = ("depth",)
    depth: tuple[float, float] = (0.4, 2.5)
    """Nearest and farthest z, m; the beginning is uniform in 1 / depth."""
    eccentricity: float = 0.7
    """Greatest angle from straight ahead, seen from between the eyes, rad."""
    speed: tuple[float, float] = (0.08726646259971647, 0.6981317007977318)
    """Range of the angular speed of a trial, seen from between the eyes, rad/s."""
    approach: float = 1.0
    """Greatest rate of 1 / distance from between the eyes, to and fro, 1/(m s)."""
    turn_after: tuple[float, float] = (0.15, 0.5)
    """Shortest and longest time from one turn to the next, s."""
    margin: float = 0.03490658503988659
    """Least distance of the fixating angles from the actuators' limits, rad."""
    start: Literal["rest", "fixation"] = "fixation"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._refuse_unordered("depth", "speed", "turn_after")
        if not self.eccentricity < 1.5:
            raise ConfigurationError(
                f"target.eccentricity: expected less than 1.5 rad, got {self.eccentricity}"
            )
        if not self.speed[1] * self.turn_after[1] < 1.5:
            raise ConfigurationError(
                "target.turn_after: expected less than 1.5 rad from turn to turn at the greatest "
                f"speed, got {self.turn_after} s at {self.speed[1]:g} rad/s"
            )

    def draw(
        self, head: HeadModel, streams: Streams, ids: IntArray, board: Board = POINT
    ) -> tuple[FloatArray, FloatArray]:
        """See `Target.draw`; stretches are drawn until one is fit."""
        paths = np.empty((len(ids), 4 * (_STRETCHES + 2)))
        walk = Walk(
            *self.depth,
            self.eccentricity,
            *self.speed,
            self.approach,
            *self.turn_after,
            self.margin,
        )
        keys = Keys(streams.seeds[ids], streams.trials[ids])
        if not choose_paths(bare(keys), bare(Gaze.of(head)), bare(walk), bare(board), paths):
            raise TargetError(
                f"target: expected paths that this head can follow and see{wholly(board)}, "
                f"got none of {ATTEMPTS} of {self}"
            )
        beginning = paths[:, 5:8]
        return motion_rows(beginning, before=beginning, path=paths), self._begin(head, beginning)


class Walk(NamedTuple):
    """The fields of a `WanderTarget`, as the kernel takes them."""

    near: float
    far: float
    eccentricity: float
    slowest: float
    fastest: float
    approach: float
    soonest: float
    latest: float
    margin: float


@device
def _go_on(path: FloatArray, knot: int, words: Words, walk: Walk) -> bool:
    """Draw the knot after one.

    Returns:
        Whether it lies at a finite distance.
    """
    here, there = 4 * knot, 4 * knot + 4
    ex, ey, ez = path[1], path[2], path[3]
    x, y, z = path[here + 1] - ex, path[here + 2] - ey, path[here + 3] - ez
    r = sqrt(x * x + y * y + z * z)
    x, y, z = x / r, y / r, z / r
    span = between(words[0], walk.soonest, walk.latest)
    nearness = 1.0 / r + between(words[1], -walk.approach, walk.approach) * span
    if nearness <= 0.0:
        return False
    # two directions across the line of sight: one level, and one down
    level = hypot(x, z)
    ax, az = z / level, -x / level
    bx, by, bz = y * az, z * ax - x * az, -y * ax
    towards = 2.0 * pi * to_uniform(words[2])
    c = cos(path[0] * span) / nearness
    sa = sin(path[0] * span) * cos(towards) / nearness
    sb = sin(path[0] * span) * sin(towards) / nearness
    path[there] = path[here] + span
    path[there + 1] = ex + c * x + sa * ax + sb * bx
    path[there + 2] = ey + c * y + sb * by
    path[there + 3] = ez + c * z + sa * az + sb * bz
    return True


@subroutine
def _can_look(
    gaze: Gaze,
    walk: Walk,
    board: Board,
    eye: Vector,
    point: Vector,
    angles: FloatArray,
    own: FloatArray,
) -> bool:
    """Whether a point is in the workspace, and both eyes can look at it.

    The last two are results, (4,) angles of the eyes' joints, and of their actuators.
    """
    x, y, z = point
    if not walk.near <= z <= walk.far:
        return False
    if hypot(x - eye[0], y - eye[1]) > z * tan(walk.eccentricity):
        return False
    if not can_fixate(gaze, walk.margin, point, angles):
        return False
    # a point that is fixated is seen
    if len(board.outline) and not in_view(gaze.head, angles, point, 0.0, board):
        return False
    direct = is_direct(gaze.head)
    for i in range(SLOTS):
        own[i] = angles[i] if direct else actuator_at(gaze.head, i, angles)
    return True


@device
def _can_follow(
    gaze: Gaze,
    walk: Walk,
    board: Board,
    path: FloatArray,
    knot: int,
    angles: FloatArray,
    own: FloatArray,
) -> bool:
    """Whether both eyes can look along the stretch after a knot, and turn as fast as it asks.

    The last two are room for (4,) angles of the eyes' joints, and (_SAMPLES + 1, 4) of their
    actuators, of which the first are those at the knot.
    """
    eye = (path[1], path[2], path[3])
    step = (path[4 * knot + 4] - path[4 * knot]) / _SAMPLES
    for k in range(1, _SAMPLES + 1):
        point = on_stretch(path, knot, path[4 * knot] + k * step)
        if not _can_look(gaze, walk, board, eye, point, angles, own[k]):
            return False
        for i in range(SLOTS):
            if abs(own[k, i] - own[k - 1, i]) > _SHARE_OF_SPEED * gaze.velocity[i] * step:
                return False
    return True


@compiled
def choose_paths(keys: Keys, gaze: Gaze, walk: Walk, board: Board, paths: FloatArray) -> bool:
    """Draw paths for each trial, stretch by stretch, until the eyes can follow one.

    Args:
        keys: `bare`, those of the n trials' random numbers.
        gaze: `bare`, the head that has to look.
        walk: `bare`.
        board: `bare`, what the target looks like.
        paths: (n, 4 + 4 k) the result with k knots, see `vergence.envs.targets.path`.

    Returns:
        False if some trial has no fit candidate.
    """
    keys, gaze, walk, board = Keys(*keys), Gaze(*gaze), Walk(*walk), Board(*board)
    eye = between_eyes(gaze.head, gaze.rest)
    angles, own = np.empty(4), np.empty((_SAMPLES + 1, SLOTS))
    last = paths.shape[1] // 4 - 1
    for n in range(len(paths)):
        seed, trial, path = keys.seeds[n], keys.trials[n], paths[n]
        # one draw of the speed for all candidates, or those that can be followed would be slower
        path[0] = between(random_words(seed, trial, _TASK, 0, 4)[0], walk.slowest, walk.fastest)
        path[1], path[2], path[3] = eye
        knot = 0
        for attempt in range(ATTEMPTS):
            words = random_words(seed, trial, _TASK, attempt, 1)
            point = place(words, eye, walk.near, walk.far, walk.eccentricity)
            path[4] = 0.0
            path[5], path[6], path[7] = point
            knot = 1 if _can_look(gaze, walk, board, eye, point, angles, own[0]) else 0
            tried = 0
            while 0 < knot < last and tried < _TURNS:
                block = (attempt * last + knot) * _TURNS + tried
                words = random_words(seed, trial, _TASK, block, 2)
                tried += 1
                if _go_on(path, knot, words, walk) and _can_follow(
                    gaze, walk, board, path, knot, angles, own
                ):
                    own[0] = own[_SAMPLES]
                    knot, tried = knot + 1, 0
            if knot == last:
                break
        if knot < last:
            return False
    return True
