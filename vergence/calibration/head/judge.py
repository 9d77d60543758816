"""Judge a calibrated head: checks of the recording, what is determined, moved boards, depth."""

from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.calibration.adjustment import BoardPoses
from vergence.calibration.head.adjust import (
    CURVATURE_COUNT,
    HeadAdjustment,
    ParametricHead,
)
from vergence.calibration.head.fit import (
    HeadSolution,
    InitialBoardPoses,
    estimate_consensus_board_poses,
)
from vergence.calibration.head.recording import HeadFrames
from vergence.calibration.uncertainty import clustered_covariance
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.parts import EYE_NAMES, NECK, FloatArray

_LEAST_RECORDED_POSES: Final = 6
"""Fewest poses of a recording (chosen: fewer carry no evidence on errors)."""
_SWAPPED_SPREAD_RATIO: Final = 0.5
"""Ratio of the spread of the board's position with exchanged eyes to the spread as recorded, below
which the eyes are exchanged (chosen)."""
_LEAST_AGREEING_FRACTION: Final = 0.5
"""Fraction of inlier views up to which a recording is refused (chosen)."""
_MOST_BASELINE_RATIO: Final = 1.2
"""Ratio of the eyes' distance to the file's, either way, from which on a head is refused (chosen:
nobody mismeasures it by so much)."""
_SAME_BASELINE_FRACTION: Final = 0.025
"""Change of the eyes' distance, relative to the file's, below which no remark is made (chosen)."""
_SAME_BASELINE_MM: Final = 1.0
"""Change of the eyes' distance below which no remark is made, mm (chosen)."""
_MANY_LEFT_OUT_FRACTION: Final = 0.1
"""Fraction of an eye's views that were left out above which a remark is made (chosen)."""
_MOST_PRIOR_SIGMAS: Final = 4.0
"""Prior standard deviations by which a parameter may differ from the head's file (chosen)."""


_UNITS: Final = {"rad": (180.0 / np.pi, " degrees"), "m": (1e3, " mm"), "px": (1.0, " px")}
"""Factor and name of each unit in messages."""


def refuse_fixed_eyes(head: HeadModel) -> None:
    """Refuse a head whose eyes do not move."""
    if not head.actuation.count:
        raise ConfigurationError(
            f"expected a head whose eyes move, got {head.name!r}, a fixed pair: vergence calibrate "
            "stereo is for such"
        )


def refuse_few_poses(frames: HeadFrames) -> None:
    """Refuse a recording of a few poses."""
    poses = len(np.unique(frames.pose)) if len(frames.time_s) else 0
    if poses < _LEAST_RECORDED_POSES:
        raise ConfigurationError(
            f"expected a recording of at least {_LEAST_RECORDED_POSES} poses that show the board, "
            f"better 60, got {poses}: turn the eyes, and the neck, to other angles between the "
            "frames"
        )


def refuse_swapped_eyes(head: HeadModel, frames: HeadFrames, start: InitialBoardPoses) -> None:
    """Refuse a recording with the images of the left and right eye exchanged."""
    both = np.asarray(frames.shown.all(axis=0))
    if not both.any():
        return
    some = frames.select(both)
    exchanged = replace(some, pixels=some.pixels[::-1], sigma=some.sigma[::-1])
    spread_m = estimate_consensus_board_poses(head, exchanged).spread_m
    if spread_m < _SWAPPED_SPREAD_RATIO * start.spread_m:
        raise ConfigurationError(
            "expected the left eye's images as the left ones, got images that go with each other "
            "if left and right are exchanged"
        )


def refuse_implausible_solution(solution: HeadSolution) -> None:
    """Refuse a fit with mostly outliers or few poses, and a head far from its file."""
    frames, kept_corners = solution.problem.frames, solution.kept_corners
    views = frames.shown.sum()
    fraction = kept_corners.any(axis=-1).sum() / views
    if fraction <= _LEAST_AGREEING_FRACTION:
        raise ConfigurationError(
            f"expected views that agree with each other, got {views} of which "
            f"{100.0 * fraction:.0f} % do: do the joint angles belong to the "
            "images, and did the board stand still?"
        )
    refuse_few_poses(frames.select(np.asarray(kept_corners.any(axis=(0, 2)))))
    was, now = baselines_m(solution)
    if not 1.0 / _MOST_BASELINE_RATIO < now / was < _MOST_BASELINE_RATIO:
        raise ConfigurationError(
            f"expected eyes about {1e3 * was:.0f} mm apart, as the head's file has them, got "
            f"{1e3 * now:.0f} mm: is the board of the stated size, "
            f"{solution.problem.frames.target}?"
        )
    problem = solution.problem
    off, sigma = solution.state.head_parameters - problem.prior_mean, problem.prior_sigma
    away = np.abs(off) / np.where(sigma > 0.0, sigma, np.inf)
    worst = int(away.argmax())
    if away[worst] > _MOST_PRIOR_SIGMAS:
        names, units, _ = problem.nominal_head.parameters()
        scale, unit = _UNITS.get(units[worst], (1.0, ""))
        raise ConfigurationError(
            f"expected a head that is like its file, got one whose {names[worst]} is "
            f"{scale * off[worst]:.3g}{unit} off, where {scale * sigma[worst]:.3g}{unit} are "
            "usual: is the board of the stated size, and do the angles' signs and zeros go with "
            "the file?"
        )


def baselines_m(solution: HeadSolution) -> tuple[float, float]:
    """Distances between the cameras at rest, m: nominal, and as calibrated."""
    heads = (solution.problem.nominal_head, solution.head)
    places = [head.camera_poses(head.rest())[:, :3, 3] for head in heads]
    was, now = (float(np.linalg.norm(right - left)) for left, right in places)
    return was, now


def remark_on_changed_baseline(solution: HeadSolution) -> list[str]:
    """Remark on a head that is larger or smaller than its file, as a wrong board size makes it."""
    was, now = (1e3 * each for each in baselines_m(solution))
    if abs(now - was) < max(_SAME_BASELINE_MM, _SAME_BASELINE_FRACTION * was):
        return []
    return [
        f"the eyes come out {now:.1f} mm apart, where the file has {was:.1f}: lengths are as right "
        f"as the board ({solution.problem.frames.target}), so measure both"
    ]


def remark_on_few_views(frames: HeadFrames, kept_corners: NDArray[np.bool_]) -> list[str]:
    """Remark on eyes without views, or with many views left out."""
    lines = []
    for eye, name in enumerate(EYE_NAMES):
        views = int(frames.shown[eye].sum())
        out = views - int(kept_corners[eye].any(axis=-1).sum())
        if not views:
            lines.append(f"the {name} eye has never seen the board: it stays as its file has it")
        elif out > _MANY_LEFT_OUT_FRACTION * views:
            lines.append(
                f"{out} of {views} views of the {name} eye do not go with the others and are left "
                "out: do they show the board, at the same time as the other eye's?"
            )
    return lines


_LEAST_INFORMATION: Final = 1.0
"""Information relative to the prior's from which on a direction counts as observed (chosen)."""
_NO_EFFECT_PX: Final = 0.02
"""Largest rms effect of one prior standard deviation along a direction on which no image depends,
px; to first order it is zero (numerical)."""
_RIGID_MISFIT: Final = 0.1
"""Fraction of its pixel effect by which a direction may differ from a rigid motion (chosen)."""
_FIXATION_SLOPES: Final = (
    (0.0, 0.0), (0.35, 0.0), (-0.35, 0.0), (0.0, 0.3), (0.0, -0.3), (0.3, 0.3)
)  # fmt: skip
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


class UnobservableDirection(NamedTuple):
    """A direction that a recording does not determine, in words."""

    what: str
    cure: str
    """Remedy, to be recorded; empty if nothing helps and nothing depends on it."""
    cost: str
    """Effect of an error of one prior standard deviation in the head's file."""


def unobservable_directions(solution: HeadSolution) -> tuple[UnobservableDirection, ...]:
    """Describe the directions that a recording does not determine."""
    prior_sigma = solution.problem.prior_sigma
    free, p = np.flatnonzero(prior_sigma > 0.0), len(prior_sigma)
    S = prior_sigma[free]
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
    scaled = moved[:, free] * S  # px per prior standard deviation
    _, strength, right_vectors = np.linalg.svd(scaled @ unobserved, full_matrices=False)
    found: list[UnobservableDirection] = []
    redundant = strength / np.sqrt(len(moved)) < _NO_EFFECT_PX
    if redundant.any():
        found.append(
            UnobservableDirection(
                f"{redundant.sum()} combinations of numbers that describe one and the same head, "
                "such as a joint's offset against the camera's turn about its axis",
                "",
                "nothing depends on them: judge optical axes and points, never single numbers",
            )
        )
    remaining = unobserved @ right_vectors[~redundant].T
    remedy = "a neck; without one, N is where the file has it"
    if any(solution.problem.nominal_head.joints[NECK]):
        remedy = "move the neck"
    shares: list[FloatArray] = []
    by_remaining = scaled @ remaining
    for axis, (name, unit) in enumerate(_RIGID_MOTIONS if by_remaining.shape[1] else ()):
        # the combination whose effects are a rigid motion, if there is one
        share = np.linalg.lstsq(by_remaining, rigid[:, axis], rcond=None)[0]
        misfit = ((by_remaining @ share - rigid[:, axis]) ** 2).sum()
        if misfit < _RIGID_MISFIT**2 * (rigid[:, axis] ** 2).sum():
            shares.append(share)
            cost = _cost(axis, unit, 1.0 / float(np.linalg.norm(share)))
            cost += ", if the file is a deviation off"
            found.append(UnobservableDirection(name, remedy, cost))
    if shares:
        remaining = remaining @ np.linalg.svd(np.array(shares))[2][len(shares) :].T
    names = [solution.problem.nominal_head.parameters().names[place] for place in free]
    for direction in remaining.T:
        most = np.argsort(-np.abs(direction))[:3]
        named = [names[each] for each in most if abs(direction[each]) > 0.3] or [names[most[0]]]
        px = float(np.sqrt(np.mean((scaled @ direction) ** 2)))
        every = " ".join(named)
        remedy = next(cure for parts, cure in _REMEDIES if any(part in every for part in parts))
        found.append(UnobservableDirection(" against ".join(named), remedy, f"{px:.2g} px"))
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
    there = (points @ T[:3, :3].T + T[:3, 3])[:, None]
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


def _cost(axis: int, unit: str, amount: float) -> str:
    if unit == "m":
        return f"{1e3 * amount:.2g} mm"
    aside = "" if axis == 2 else f", {1e3 * amount:.2g} mm aside at 1 m"
    return f"{np.rad2deg(amount):.2g} degrees{aside}"


_REMEDIES: Final = (
    ((".camera.k", ".camera.p"), "bring the board to the corners of the images"),
    ((".camera.",), "bring the board nearer and farther, and to all parts of the images"),
    (("both.", ".rz"), "turn the joints farther"),
    (("",), "turn the joints farther, with the board nearer"),
)
"""Remedies by parts of the names of parameters that a recording does not determine."""


_LEAST_MOVED_POSES: Final = 3
"""Fewest poses with the board at another placement (chosen: fewer are wrong detections)."""
_LEAST_CONTIGUOUS_FRACTION: Final = 0.5
"""Least fraction of the frames between the first and the last of a placement that show the board
there (chosen: a moved board stays, while wrong detections that happen to agree are scattered)."""
_MOST_SPREAD_SIZES: Final = 0.05
"""Largest spread of the corners among views of one placement, in board sizes (chosen: the head is
calibrated then, except for parameters that the first placement alone did not determine)."""


_MOVED_COST_DECREASE: Final = 80.0
"""Decrease of the sum of squares by a step of the board's pose (six parameters) from which on the
board was moved (chosen: 40 occur by chance once in a million moments, and backlash and other model
errors add to it)."""


def find_new_placement(solution: HeadSolution) -> InitialBoardPoses | None:
    """All frames with the board's placements on which left-out views agree; None if on no other."""
    frames = solution.problem.frames
    views = np.asarray(solution.kept_corners.any(axis=-1))
    lost = np.asarray(frames.shown.any(axis=0) & ~views.any(axis=0))
    if len(np.unique(frames.pose[lost])) < _LEAST_MOVED_POSES:
        return None
    some = frames.select(lost)
    start = estimate_consensus_board_poses(
        solution.head, replace(some, placement=np.zeros(lost.sum(), dtype=np.intp))
    )
    agreeing = np.flatnonzero(lost)[start.inlier_views.any(axis=0)]
    if (
        start.spread_m > _MOST_SPREAD_SIZES * frames.size_m
        or len(np.unique(frames.pose[agreeing])) < _LEAST_MOVED_POSES
        or len(agreeing) < _LEAST_CONTIGUOUS_FRACTION * (agreeing[-1] - agreeing[0] + 1)
    ):
        return None
    placement = frames.placement.copy()
    placement[agreeing] = placement.max() + 1
    pixels, sigma, inlier_views = frames.pixels.copy(), frames.sigma.copy(), views.copy()
    pixels[:, lost], sigma[:, lost] = start.frames.pixels, start.frames.sigma
    inlier_views[:, lost] = start.inlier_views
    boards = map(np.concatenate, zip(solution.state.boards, start.boards, strict=True))
    first, last = frames.time_s[agreeing[0]], frames.time_s[agreeing[-1]]
    return InitialBoardPoses(
        replace(frames, placement=placement, pixels=pixels, sigma=sigma),
        BoardPoses(*boards),
        inlier_views,
        start.spread_m,
        f"the board stands elsewhere in {len(agreeing)} frames, from {first:.1f} to {last:.1f} s: "
        "counted as a new placement",
    )


def find_small_board_motion(solution: HeadSolution) -> InitialBoardPoses | None:
    """Frames with a new placement from the moment a small motion explains much; else None."""
    problem = solution.problem
    frames = problem.frames
    normal, blocks, slopes = solution.normal_and_frame_parts()
    size, six = problem.shared_count, np.arange(6)
    inverse = np.linalg.inv(normal.matrix)
    best, when = 0.0, 0
    board = problem.common_count
    across, own, pull = np.zeros((size + 1, 6)), np.zeros((6, 6)), np.zeros(6)
    for frame in range(len(frames.time_s) - 1, 0, -1):
        columns = problem.frame_columns[frame]
        np.add.at(across, columns, blocks[frame][:, board + six])
        own += blocks[frame][np.ix_(board + six, board + six)]
        pull += slopes[frame][board + six]
        if frames.placement[frame - 1] != frames.placement[frame]:
            across[:], own[:], pull[:] = 0.0, 0.0, 0.0
        elif frames.pose[frame - 1] != frames.pose[frame]:
            left = own - across[:-1].T @ inverse @ across[:-1]
            pulled = pull - across[:-1].T @ inverse @ normal.gradient
            gain = float(pulled @ np.linalg.lstsq(left, pulled, rcond=_RANK_TOLERANCE)[0])
            if gain > best:
                best, when = gain, frame
    if best < _MOVED_COST_DECREASE * max(solution.reduced_chi, 1.0) ** 2:
        return None
    placement = frames.placement.copy()
    later = (placement == placement[when]) & (np.arange(len(placement)) >= when)
    placement[later] = placement.max() + 1
    split = replace(frames, placement=placement)
    start = estimate_consensus_board_poses(problem.nominal_head, split)
    return start._replace(
        remark=f"the board seems to have been moved before {frames.time_s[when]:.1f} s: counted as "
        "a new placement"
    )


_RANK_TOLERANCE: Final = 1e-9
"""Relative cutoff of singular values: a few frames may not determine a step fully (numerical)."""


def head_and_term_covariance(solution: HeadSolution) -> FloatArray:
    """(p + t, p + t) covariance of `HeadModel.parameters`, then of the reading-error terms."""
    problem = solution.problem
    normal, blocks, slopes = solution.normal_and_frame_parts()
    return clustered_head_covariance(
        problem, normal.matrix, problem.frame_columns, blocks, slopes, solution.reduced_chi,
        problem.frames.pose,
    )  # fmt: skip


def clustered_head_covariance(
    problem: HeadAdjustment, matrix: FloatArray, columns: NDArray[np.intp], blocks: FloatArray,
    slopes: FloatArray, reduced_chi: float, pose: NDArray[np.intp] | None = None,
) -> FloatArray:  # fmt: skip
    """(p + t, p + t) covariance by (f, s_f, s_f) blocks, one a pose unless `pose` numbers them."""
    p = len(problem.prior_mean)
    term_indices = np.arange(p + CURVATURE_COUNT, problem.common_count)
    kept = np.concatenate([np.arange(p), term_indices])
    rest = np.setdiff1d(np.arange(problem.shared_count), kept)
    # eliminate the boards and the errors of resting joints
    reduced = np.zeros((problem.shared_count + 1, len(kept)))
    reduced[kept] = np.eye(len(kept))
    reduced[rest] = -np.linalg.solve(matrix[np.ix_(rest, rest)], matrix[np.ix_(rest, kept)])
    known = np.append(problem.prior_information, 0.0)
    number = np.arange(len(blocks)) if pose is None else np.unique(pose, return_inverse=True)[1]
    information = np.zeros((number.max() + 1, len(kept), len(kept)))
    gradients = np.zeros(information.shape[:2])
    for each, block, slope, own in zip(number, blocks, slopes, columns, strict=True):
        into = reduced[own]
        information[each] += into.T @ block @ into
        gradients[each] += slope @ into
    prior = reduced.T @ (known[:, None] * reduced)
    return clustered_covariance(information, gradients, max(reduced_chi, 1.0), prior)
