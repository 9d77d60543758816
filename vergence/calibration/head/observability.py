"""Unobservable directions of a head's parameters in a recording, in words, with a remedy for each.

The information matrix of a recording is scaled by the prior standard deviations. An eigenvalue
below 1 belongs to a direction that the recording determines worse than the prior; the prior holds
such directions. They are of three kinds:

- some combinations of parameters describe one and the same head, such as the offset of a pan joint
  and the head-eye rotation about its axis: nothing depends on them, and no data determine them;
- both eyes may move together as a rigid body in the neck's frame, which is not observable while the
  neck rests;
- remaining directions are named by the parameters with the largest components.
"""

from typing import Final, NamedTuple

import numpy as np

from vergence.calibration.adjustment import BoardPoses
from vergence.calibration.head.chain import ParametricHead, board_points_and_offsets
from vergence.calibration.head.solution import HeadSolution
from vergence.models.parts import NECK, FloatArray

_LEAST_INFORMATION: Final = 1.0
"""Information relative to the prior's from which on a direction counts as observed (chosen)."""
_NO_EFFECT_PX: Final = 0.02
"""Largest rms effect of one prior standard deviation along a direction on which no image depends,
px; to first order it is zero (numerical)."""
_RIGID_MISFIT: Final = 0.1
"""Fraction of its pixel effect by which a direction may differ from a rigid motion (chosen)."""
_FIXATION_SLOPES: Final = (
    (0.0, 0.0),
    (0.35, 0.0),
    (-0.35, 0.0),
    (0.0, 0.3),
    (0.0, -0.3),
    (0.3, 0.3),
)
"""Slopes x/z and y/z of the fixated points at which effects are evaluated (chosen)."""
_DISTANCES_M: Final = (0.5, 1.0, 2.5)
"""Distances z of the fixated points, m (chosen: the range of use)."""
_RIGID_MOTIONS: Final = (
    ("tilt of both eyes in common", "rad"),
    ("turn of both eyes in common about the vertical", "rad"),
    ("roll of both eyes in common", "rad"),
    ("shift of both eyes to the side", "m"),
    ("shift of both eyes up or down", "m"),
    ("shift of both eyes forward", "m"),
)
"""Rigid motions of the eyes in N, about and along x, y and z, with units."""

_NO_NECK_REMEDY: Final = "a neck; without one, N is where the file has it"


class UnobservableDirection(NamedTuple):
    """A direction that a recording does not determine, in words."""

    what: str
    remedy: str
    """Remedy, to be recorded; empty if nothing helps and nothing depends on it."""
    cost: str
    """Effect of an error of one prior standard deviation in the head's file."""


def unobservable_directions(solution: HeadSolution) -> tuple[UnobservableDirection, ...]:
    """Describe the directions that a recording does not determine."""
    prior_sigma = solution.problem.prior_sigma
    free = np.flatnonzero(prior_sigma > 0.0)
    S = prior_sigma[free]
    p = len(prior_sigma)
    matrix, known = solution.normal.matrix, solution.problem.prior_information
    rest, across = matrix[p:, p:], matrix[:p, p:]
    data_information = (
        matrix[:p, :p] - np.diag(known[:p]) - across @ np.linalg.solve(rest, across.T)
    )
    values, vectors = np.linalg.eigh(S[:, None] * data_information[np.ix_(free, free)] * S)
    unobserved = vectors[:, values < _LEAST_INFORMATION]
    if not unobserved.shape[1]:
        return ()
    moved, rigid = _effects(solution)
    effect = moved[:, free] * S @ unobserved  # px per prior standard deviation along each direction
    size = np.sqrt(len(moved))
    _, strength, right_vectors = np.linalg.svd(effect, full_matrices=False)
    found: list[UnobservableDirection] = []
    redundant = int((strength / size < _NO_EFFECT_PX).sum())
    if redundant:
        found.append(
            UnobservableDirection(
                f"{redundant} combinations of numbers that describe one and the same head, such as "
                "a joint's offset against the camera's turn about its axis",
                "",
                "nothing depends on them: judge optical axes and points, never single numbers",
            )
        )
    remaining = unobserved @ right_vectors[strength / size >= _NO_EFFECT_PX].T
    remedy = "move the neck" if any(solution.problem.nominal_head.joints[NECK]) else _NO_NECK_REMEDY
    shares: list[FloatArray] = []
    for axis, (name, unit) in enumerate(_RIGID_MOTIONS):
        share = _share_of_rigid(moved[:, free] * S @ remaining, rigid[:, axis])
        if share is not None:
            shares.append(share)
            amount = 1.0 / float(np.linalg.norm(share))
            found.append(UnobservableDirection(name, remedy, _cost(axis, unit, amount)))
    if shares:
        remaining = remaining @ np.linalg.svd(np.array(shares))[2][len(shares) :].T
    names = [solution.problem.nominal_head.parameters().names[place] for place in free]
    for direction in remaining.T:
        most = np.argsort(-np.abs(direction))[:3]
        named = [names[each] for each in most if abs(direction[each]) > 0.3] or [names[most[0]]]
        px = float(np.sqrt(np.mean((moved[:, free] * S @ direction) ** 2)))
        found.append(UnobservableDirection(" against ".join(named), _remedy(named), f"{px:.2g} px"))
    return tuple(found)


def _effects(solution: HeadSolution) -> tuple[FloatArray, FloatArray]:
    """Jacobians of pixels at various fixations, by head parameters and by rigid motions in N."""
    head = solution.head
    chain = ParametricHead(solution.problem.nominal_head, solution.state.head_parameters)
    points = np.array(
        [[z * x, z * y, z] for z in _DISTANCES_M for x, y in _FIXATION_SLOPES], dtype=np.float64
    )
    q = head.fixate(points, head.rest()[:3], warn=False)
    # each eye looks beside the point, so that all parts of the image are covered
    beside = np.zeros((len(q), 7))
    beside[:, 3:] = (
        0.15 * np.array([[1, 1, 1, 1], [-1, 1, -1, 1], [1, -1, -1, -1]])[np.arange(len(q)) % 3]
    )
    own = head.actuation
    q = own.joints_of(own.actuators_of(np.nan_to_num(q)) + beside * (own.upper > own.lower))
    T = head.base_pose(q[0])
    boards = BoardPoses(np.broadcast_to(T[:3, :3], (len(q), 3, 3)), points @ T[:3, :3].T + T[:3, 3])
    there, _ = board_points_and_offsets(np.zeros((1, 3)), boards, np.arange(len(q)))
    turned = there - T[:3, 3]
    moved, rigid = [], []
    into_n = np.kron(np.eye(2), T[:3, :3])
    for eye in range(2):
        seen = chain.project_board(eye, q, there, turned)
        rows = np.zeros((len(q), 2, len(solution.state.head_parameters)))
        rows[:, :, chain.eye_parameter_indices[eye]] = seen.head_jacobian[:, 0]
        visible = np.isfinite(seen.pixels[:, 0]).all(axis=-1)
        moved.append(rows[visible].reshape(-1, rows.shape[-1]))
        # a motion of the eyes is the opposite motion of the world
        rigid.append(-(seen.board_jacobian[visible, 0] @ into_n).reshape(-1, 6))
    return np.concatenate(moved), np.concatenate(rigid)


def _share_of_rigid(moved: FloatArray, rigid: FloatArray) -> FloatArray | None:
    """(m,) combination of (r, m) effects, px per prior sigma, that is a rigid motion; or None."""
    if not moved.shape[1]:
        return None
    share = np.asarray(np.linalg.lstsq(moved, rigid, rcond=None)[0])
    missed = moved @ share - rigid
    return share if (missed**2).sum() < _RIGID_MISFIT**2 * (rigid**2).sum() else None


def _cost(axis: int, unit: str, amount: float) -> str:
    if unit == "m":
        return f"{1e3 * amount:.2g} mm, if the file is a deviation off"
    aside = "" if axis == 2 else f", {1e3 * amount:.2g} mm aside at 1 m"
    return f"{np.rad2deg(amount):.2g} degrees{aside}, if the file is a deviation off"


def _remedy(names: list[str]) -> str:
    if any(".camera.k" in name or ".camera.p" in name for name in names):
        return "bring the board to the corners of the images"
    if any(".camera." in name for name in names):
        return "bring the board nearer and farther, and to all parts of the images"
    if any(name.startswith("both.") for name in names) or any(".rz" in n for n in names):
        return "turn the joints farther"
    return "turn the joints farther, with the board nearer"
