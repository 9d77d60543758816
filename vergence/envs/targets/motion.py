r"""Motion of a target, as one row of numbers per trial that compiled kernels can follow.

    P(t) = before                                                        t < t_jump
    P(t) = anchor + velocity min(t - t_jump, duration)
                  + cosine cos(omega t) + sine sin(omega t)              t >= t_jump

in frame N as it is at the trial's start, in metres and seconds. The time t is counted from the
moment at which the scene begins to change, and may be negative. At a second jump, another anchor
replaces the first one, and the rest of the motion goes on. A row with a path is longer, and the
target follows the path (`vergence.envs.targets.path`) from the jump on. A target cannot be seen
while it is hidden, nor before the jump if it has no position `before`. Each kind of target in
`vergence.envs.targets.registry` is a choice of these numbers.
"""

from math import cos, inf, nan, sin
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from vergence.envs.targets.path import MIN_PATH_LENGTH, point_at
from vergence.kernels import inlined, kernel, make_tuple_reader
from vergence.models.kinematics import Vector
from vergence.models.parts import FloatArray

# indices of the fields in a motion's row (numerical)
BEFORE: Final = slice(0, 3)
ANCHOR: Final = slice(3, 6)
VELOCITY: Final = slice(6, 9)
COSINE: Final = slice(9, 12)
SINE: Final = slice(12, 15)
OMEGA: Final = 15
JUMP: Final = 16
DURATION: Final = 17
SEEN_BEFORE: Final = 18
SECOND_JUMP: Final = 19
SECOND_ANCHOR: Final = slice(20, 23)
HIDDEN_FROM: Final = 23
HIDDEN_UNTIL: Final = 24
MOTION: Final = 25
"""Length of a motion's row without a path."""


def motion_rows(
    anchor: ArrayLike,
    *,
    before: ArrayLike | None = None,
    velocity: ArrayLike = 0.0,
    duration: ArrayLike = inf,
    cosine: ArrayLike = 0.0,
    sine: ArrayLike = 0.0,
    omega: ArrayLike = 0.0,
    jump_time: ArrayLike = 0.0,
    second_jump_time: ArrayLike = inf,
    second_anchor: ArrayLike | None = None,
    hidden_from: ArrayLike = inf,
    hidden_until: ArrayLike = inf,
    path: FloatArray | None = None,
) -> FloatArray:
    """Make rows of motions.

    Args:
        anchor: (n, 3) position of the target at rest, or centre of its motion, m.
        before: (n, 3) position until the jump, m; None if the target was not there, so that the
            images before time zero show nothing.
        velocity: (n, 3) or a scalar, velocity from the jump on, m/s.
        duration: (n,) or a scalar, duration of the motion with this velocity, s.
        cosine: (n, 3) or a scalar, amplitude of the motion in phase with cos(omega t), m.
        sine: (n, 3) or a scalar, amplitude of the motion in phase with sin(omega t), m.
        omega: (n,) or a scalar, rad/s.
        jump_time: (n,) or a scalar, time at which the target leaves `before`, s.
        second_jump_time: (n,) or a scalar, time of a second jump, not before `jump_time`, s.
        second_anchor: (n, 3) position that replaces `anchor` then, m; None for the same.
        hidden_from: (n,) or a scalar, time from which the target is hidden, s.
        hidden_until: (n,) or a scalar, time from which it is visible again, s.
        path: (n, p) paths that begin at `anchor`, see `vergence.envs.targets.path`; None for
            targets without a path.

    Returns:
        (n, MOTION), or (n, MOTION + p) with paths.
    """
    anchor = np.atleast_2d(np.asarray(anchor, dtype=np.float64))
    rows = np.zeros((len(anchor), MOTION + (0 if path is None else path.shape[1])))
    rows[:, BEFORE] = anchor if before is None else before
    rows[:, ANCHOR] = anchor
    rows[:, VELOCITY] = velocity
    rows[:, COSINE] = cosine
    rows[:, SINE] = sine
    rows[:, OMEGA] = omega
    rows[:, JUMP] = jump_time
    rows[:, DURATION] = duration
    rows[:, SEEN_BEFORE] = before is not None
    rows[:, SECOND_JUMP] = second_jump_time
    rows[:, SECOND_ANCHOR] = anchor if second_anchor is None else second_anchor
    rows[:, HIDDEN_FROM] = hidden_from
    rows[:, HIDDEN_UNTIL] = hidden_until
    if path is not None:
        rows[:, MOTION:] = path
    return rows


def last_jump_time(rows: ArrayLike) -> FloatArray:
    """Times of the targets' last jumps, s: of the second jump, or of the only one.

    Args:
        rows: (..., MOTION or more) motions.

    Returns:
        (...) s.
    """
    rows = np.asarray(rows, dtype=np.float64)
    again = np.isfinite(rows[..., SECOND_JUMP])
    return np.where(again, rows[..., SECOND_JUMP], rows[..., JUMP])


class Motion(NamedTuple):
    """The fields of a motion's row, see `motion_rows`."""

    before: Vector
    anchor: Vector
    velocity: Vector
    cosine: Vector
    sine: Vector
    omega: float
    jump_time: float
    duration: float
    seen_before: bool
    second_jump_time: float
    second_anchor: Vector
    hidden_from: float
    hidden_until: float
    path: FloatArray
    """(p,) path; (0,) for a target without one."""


_read_motion_fields = make_tuple_reader(MOTION)


@inlined
def unpack_motion(row: FloatArray) -> Motion:
    """Unpack a motion's row, in the order of the constants above."""
    m = _read_motion_fields(row, 0)
    return Motion(
        (m[0], m[1], m[2]),
        (m[3], m[4], m[5]),
        (m[6], m[7], m[8]),
        (m[9], m[10], m[11]),
        (m[12], m[13], m[14]),
        m[OMEGA],
        m[JUMP],
        m[DURATION],
        m[SEEN_BEFORE] != 0.0,
        m[SECOND_JUMP],
        (m[20], m[21], m[22]),
        m[HIDDEN_FROM],
        m[HIDDEN_UNTIL],
        row[MOTION:],
    )


@inlined
def motion_position_at(motion: Motion, t: float) -> Vector:
    """Position of a target at time `t`, in N as it was at the trial's start."""
    if t < motion.jump_time:
        return motion.before
    if len(motion.path):
        return point_at(motion.path, t)
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
def is_shown(motion: Motion, t: float) -> bool:
    """True if the target exists and is not hidden at time `t`, in view or not."""
    if t < motion.jump_time and not motion.seen_before:
        return False
    return not motion.hidden_from <= t < motion.hidden_until


@kernel(["(f8[:],f8[:],f8[:],f8[:])"], "(m),(),(3)->(3)")
def _positions(row: FloatArray, t: FloatArray, shape_only: FloatArray, out: FloatArray) -> None:
    out[0] = out[1] = out[2] = nan
    beyond = len(row) - MOTION
    if beyond == 0 or beyond >= MIN_PATH_LENGTH:
        out[0], out[1], out[2] = motion_position_at(unpack_motion(row), t[0])


def target_position(rows: ArrayLike, time_s: ArrayLike) -> FloatArray:
    """Positions of targets.

    Args:
        rows: (..., MOTION or more) motions; a row of invalid length gives nan.
        time_s: (...) seconds since the scene begins to change.

    Returns:
        (..., 3) in N as it stood at the trial's start, m.
    """
    return np.asarray(_positions(rows, time_s, np.zeros(3)))
