"""Targets of the gaze task: their shape, and their motion as a row of numbers for kernels.

P(t) = before                                                        t < t_jump
    P(t) = anchor + velocity min(t - t_jump, duration)
                  + cosine cos(omega t) + sine sin(omega t)              t >= t_jump

in frame N as it is at the trial's start, in metres and seconds. The time t is counted from the
moment at which the scene begins to change, and may be negative. At a second jump, another anchor
replaces the first one, and the rest of the motion goes on. A row with a path is longer, and the
target follows the path from the jump on. A target cannot be seen
while it is hidden, nor before the jump if it has no position `before`. Each kind of target in
`vergence.envs.targets.TARGETS` is a choice of these numbers.

A path is a flat array of groups of four. The first group is (speed, x, y, z): the angular speed,
rad/s, and the viewpoint E, m. Each knot adds a group (t, x, y, z), s and m, the first at time zero.
From knot A to knot B, a time T later, the line of sight from E turns along a great circle and the
inverse of the distance changes, both at a constant rate. With u the unit vectors from E to the
knots, r their distances, and s the time since A,

    u(s) = (sin(speed (T - s)) u_A + sin(speed s) u_B) / sin(speed T)
    1 / r(s) = (1 - s / T) / r_A + (s / T) / r_B

so the angle between u_A and u_B must be speed T, less than pi. After the last knot the target goes
back along the path, and from the first knot forth again.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import cos, hypot, inf, nan, sin, sqrt
from typing import Annotated, Any, ClassVar, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.envs.reading import check_tuple_or_nonnegative
from vergence.envs.streams import IntArray, RandomStreams
from vergence.errors import ConfigurationError, UnreachableTargetError
from vergence.kernels import inlined, kernel, record_view, row_layout, row_size, subroutine
from vergence.models.head import HeadModel
from vergence.models.kinematics import (
    PackedHead,
    Vector,
    camera_of,
    eye_frames,
    point_in_eye,
    point_to_pixel,
)
from vergence.models.parts import FloatArray

MIN_PATH_LENGTH: Final = 12
"""Length of a path of two knots (numerical)."""


@inlined
def point_between_knots(path: FloatArray, knot: int, t: float) -> Vector:
    """Position between two knots."""
    a, b = 4 * knot, 4 * knot + 4
    x, y, z = path[1], path[2], path[3]
    ax, ay, az = path[a + 1] - x, path[a + 2] - y, path[a + 3] - z
    bx, by, bz = path[b + 1] - x, path[b + 2] - y, path[b + 3] - z
    nearness_a = 1.0 / sqrt(ax * ax + ay * ay + az * az)
    nearness_b = 1.0 / sqrt(bx * bx + by * by + bz * bz)
    since, span = t - path[a], path[b] - path[a]
    share = since / span
    r = 1.0 / ((1.0 - share) * nearness_a + share * nearness_b)
    r /= sin(path[0] * span)
    of_a = r * nearness_a * sin(path[0] * (span - since))
    of_b = r * nearness_b * sin(path[0] * since)
    return x + of_a * ax + of_b * bx, y + of_a * ay + of_b * by, z + of_a * az + of_b * bz


@subroutine
def point_at(path: FloatArray, t: float) -> Vector:
    """Position on a path at a time."""
    low, high = 1, len(path) // 4 - 1
    end = path[4 * high]
    if t > end:
        t = t % (2.0 * end)
        t = min(t, 2.0 * end - t)
    while high - low > 1:
        middle = (low + high) // 2
        if path[4 * middle] <= t:
            low = middle
        else:
            high = middle
    return point_between_knots(path, low, t)


class Motion:
    """Row of a target's motion, of which a path is the rest; see `motion_rows`."""

    before: Annotated[FloatArray, 3]
    anchor: Annotated[FloatArray, 3]
    velocity: Annotated[FloatArray, 3]
    cosine: Annotated[FloatArray, 3]
    sine: Annotated[FloatArray, 3]
    omega: float
    jump_time: float
    duration: float
    seen_before: float
    second_jump_time: float
    second_anchor: Annotated[FloatArray, 3]
    hidden_from: float
    hidden_until: float


_MOTION: Final = row_layout(Motion)
MOTION: Final = row_size(_MOTION)
"""Length of a motion's row without a path."""


def motion_fields(rows: FloatArray) -> NDArray[Any]:
    """(...) structured array of `Motion`'s fields: a view of rows (..., MOTION or more)."""
    return rows[..., :MOTION].view(_MOTION)[..., 0]


def motion_rows(
    anchor: ArrayLike, *, before: ArrayLike | None = None, velocity: ArrayLike = 0.0,
    duration: ArrayLike = inf, cosine: ArrayLike = 0.0, sine: ArrayLike = 0.0,
    omega: ArrayLike = 0.0, jump_time: ArrayLike = 0.0, second_jump_time: ArrayLike = inf,
    second_anchor: ArrayLike | None = None, hidden_from: ArrayLike = inf,
    hidden_until: ArrayLike = inf, path: FloatArray | None = None,
) -> FloatArray:  # fmt: skip
    """Make rows (n, MOTION) of motions, or (n, MOTION + p) with paths (n, p).

    The arguments are those of the module's formula: points, velocity and amplitudes (n, 3) in m and
    m/s, times and durations (n,) in s, omega (n,) in rad/s. With `before` None the target was not
    there, so that images before time zero show nothing. A path begins at `anchor`, and the second
    jump is not before the first.
    """
    anchor = np.atleast_2d(np.asarray(anchor, dtype=np.float64))
    rows = np.zeros((len(anchor), MOTION + (0 if path is None else path.shape[1])))
    fields = {
        "before": anchor if before is None else before, "anchor": anchor, "velocity": velocity,
        "cosine": cosine, "sine": sine, "omega": omega, "jump_time": jump_time,
        "duration": duration, "seen_before": before is not None,
        "second_jump_time": second_jump_time,
        "second_anchor": anchor if second_anchor is None else second_anchor,
        "hidden_from": hidden_from, "hidden_until": hidden_until,
    }  # fmt: skip
    for name, values in fields.items():
        motion_fields(rows)[name] = values
    if path is not None:
        rows[:, MOTION:] = path
    return rows


def last_jump_time(rows: ArrayLike) -> FloatArray:
    """Times of the targets' last jumps, s: of the second jump, or of the only one."""
    fields = motion_fields(np.ascontiguousarray(rows, dtype=np.float64))
    second = fields["second_jump_time"]
    return np.where(np.isfinite(second), second, fields["jump_time"])


@inlined
def view_motion(row: FloatArray) -> Motion:
    """The fields of a motion's row."""
    motion: Motion = record_view(row[:MOTION], _MOTION)
    return motion


@inlined
def motion_position_at(row: FloatArray, t: float) -> Vector:
    """Position of a target at time `t`, in N as it was at the trial's start."""
    motion = view_motion(row)
    if t < motion.jump_time:
        return motion.before[0], motion.before[1], motion.before[2]
    if len(row) > MOTION:
        return point_at(row[MOTION:], t)
    moved = min(t - motion.jump_time, motion.duration)
    c = s = 0.0
    if motion.omega != 0.0:
        c, s = cos(motion.omega * t), sin(motion.omega * t)
    anchor = motion.anchor if t < motion.second_jump_time else motion.second_anchor
    velocity, cosine, sine = motion.velocity, motion.cosine, motion.sine
    return (
        anchor[0] + velocity[0] * moved + cosine[0] * c + sine[0] * s,
        anchor[1] + velocity[1] * moved + cosine[1] * c + sine[1] * s,
        anchor[2] + velocity[2] * moved + cosine[2] * c + sine[2] * s,
    )


@inlined
def is_shown(row: FloatArray, t: float) -> bool:
    """True if the target exists and is not hidden at time `t`, in view or not."""
    motion = view_motion(row)
    if t < motion.jump_time and motion.seen_before == 0.0:
        return False
    return not motion.hidden_from <= t < motion.hidden_until


@kernel(["(f8[:],f8[:],f8[:],f8[:])"], "(m),(),(3)->(3)")
def _positions(row: FloatArray, t: FloatArray, shape_only: FloatArray, out: FloatArray) -> None:
    out[0] = out[1] = out[2] = nan
    beyond = len(row) - MOTION
    if beyond == 0 or beyond >= MIN_PATH_LENGTH:
        out[0], out[1], out[2] = motion_position_at(row, t[0])


def target_position(rows: ArrayLike, time_s: ArrayLike) -> FloatArray:
    """Positions of targets."""
    return np.asarray(_positions(np.ascontiguousarray(rows), time_s, np.zeros(3)))


Axes = tuple[Vector, Vector, Vector]


class Board(NamedTuple):
    """A planar target in the form kernels take, with the conditions for its detection."""

    outline: FloatArray
    """(k, 2) points round the board's edge in its own frame, m; none for a mere point."""
    true_size_distance_m: float
    """Distance at which a board that looks equally large near and far has its own size, m; nan
    for a board of constant size."""
    facing_head: bool
    """True if it is square to the line from N's origin, False if parallel to N's xy plane."""
    border_px: float  # least distance of the outline from the images' edges, px
    min_outline_segment_px: float  # least distance of neighbouring points of the outline, px


POINT: Final = Board(np.empty((0, 2)), nan, True, 0.0, 0.0)
"""A target without a board: only its measured point must be visible."""


def whole_board_text(board: Board) -> str:
    """Words that error messages add to "see" for targets with a board."""
    if not len(board.outline):
        return ""
    return (
        f" with the whole board, {board.border_px:g} px from the images' edges and not too small "
        "or large for the detector"
    )


@inlined
def board_axes(point: Vector, facing_head: bool) -> Axes:
    """The axes of a board's frame in N: right, down, and into the board."""
    if not facing_head:
        return (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    x, y, z = point
    r = sqrt(x * x + y * y + z * z)
    cx, cy, cz = x / r, y / r, z / r
    s = hypot(cx, cz)
    ax, az = cz / s, -cx / s
    return (ax, 0.0, az), (cy * az, cz * ax - cx * az, -cy * ax), (cx, cy, cz)


@inlined
def is_detectable_by_both_eyes(
    p: PackedHead, angles: FloatArray, point: Vector, border_px: float, board: Board
) -> bool:
    """True if both eyes see a target: its point, and all of its board at a detectable size."""
    k = len(board.outline)
    size = 1.0
    if k and board.true_size_distance_m == board.true_size_distance_m:
        total = 0.0
        for eye in range(2):
            camera_pose = eye_frames(p, eye, angles[2 * eye], angles[2 * eye + 1]).camera
            x, y, z = point[0] - camera_pose.x, point[1] - camera_pose.y, point[2] - camera_pose.z
            total += sqrt(x * x + y * y + z * z)
        size = 0.5 * total / board.true_size_distance_m
    right, down, _into = board_axes(point, board.facing_head)
    for eye in range(2):
        camera = camera_of(p, eye)
        border = border_px
        before_u = before_v = 0.0
        # the point itself, then once round the outline and back to where it began
        for i in range(k + 2 if k else 1):
            x, y, z = point
            if i:
                across, along = board.outline[i % k, 0] * size, board.outline[i % k, 1] * size
                x += across * right[0] + along * down[0]
                y += across * right[1] + along * down[1]
                z += across * right[2] + along * down[2]
                border = border_px + board.border_px
            x, y, z = point_in_eye(p, eye, angles[2 * eye], angles[2 * eye + 1], x, y, z)
            u, v = point_to_pixel(p, eye, x, y, z, True)
            if not (border <= u <= camera.width - 1.0 - border):
                return False
            if not (border <= v <= camera.height - 1.0 - border):
                return False
            length = hypot(u - before_u, v - before_v)
            if i > 1 and length < board.min_outline_segment_px:
                return False
            before_u, before_v = u, v
    return True


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
            if name == "start":
                continue
            default = getattr(type(self), name)
            size = len(default) if isinstance(default, tuple) else 0
            checked = check_tuple_or_nonnegative(
                f"target.{name}", value, size, name in _POSITIVE_FIELDS
            )
            if name in self.length_fields and not np.abs(np.array(checked)).max() < MAX_LENGTH_M:
                raise ConfigurationError(
                    f"target.{name}: expected metres below {MAX_LENGTH_M:g} in size (is it in "
                    "millimetres? Python takes metres, only the command line takes millimetres), "
                    f"got {value!r}"
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
        """Refuse a target that a head's eyes could not find or reach in any trial."""

    @abstractmethod
    def draw(
        self, head: HeadModel, streams: RandomStreams, ids: IntArray, board: Board = POINT
    ) -> tuple[FloatArray, FloatArray]:
        """Motions (n, MOTION or more) of some trials, and joint angles (n, 7) at the start, rad."""

    def _begin(self, head: HeadModel, fixated: FloatArray) -> FloatArray:
        if self.start == "rest":
            return np.broadcast_to(head.rest(), (len(fixated), 7)).copy()
        return fixation_angles(head, "start", fixated)


def fixation_angles(head: HeadModel, point_name: str, points: FloatArray) -> FloatArray:
    """Compute joint angles that put points on both optical axes, or as near as actuators can."""
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
    """Refuse a point that neither eye sees, as no controller could ever find it."""
    if _in_images(head, q, point).any():
        return
    where = "outside both images"
    if not np.isfinite(head.project(q, point)).any():
        where = "behind the head or far outside both images"
    raise UnreachableTargetError(
        f"target: expected a {point_name} that an eye sees at the start of the trial, got "
        f"{tuple(point.tolist())} m, which is {where}"
    )
