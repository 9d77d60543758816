"""Views by heads that were found without their poses."""

from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.calibration.head.adjust import Weights
from vergence.calibration.head.solution import HeadSolution, solved
from vergence.models.parts import FloatArray

FOLDS: Final = 5
_FOLD_TOLERANCE: Final = 1.0
"""Change of the cost below which a fold's head is near enough."""


class HeldOut(NamedTuple):
    """Errors of what heads did not know."""

    views: FloatArray
    """(2, f) mean squares of the corners, over sigma; nan without."""
    poses: FloatArray
    """(poses) mean square of the corners plus that of the readings' errors, over sigma; nan
    without. One reading counts for many corners, which are what tells its error."""


def held_out(
    solution: HeadSolution, kept: NDArray[np.bool_], noisier: FloatArray | None = None
) -> HeldOut:
    """Judge views, and the angles read for them, by heads that were found without their poses.

    Args:
        solution: of all.
        kept: (2, f, n) the corners that count.
        noisier: (7,) how readings are believed to scatter when they are judged, see
            `HeadAdjustment`; None for what the solution says.
    """
    problem, pose = solution.problem, solution.problem.frames.pose
    views = np.full(kept.shape[:2], np.nan)
    poses = np.full(int(pose.max()) + 1, np.nan)
    fold = pose * FOLDS // len(poses)
    for each in range(FOLDS):
        out = fold == each
        if not kept[:, out].any() or not kept[:, ~out].any():
            continue
        trained = problem.of(~out)
        start = trained.start(solution.state.boards)._replace(
            values=solution.state.values, bend=solution.state.bend, terms=solution.state.terms
        )
        found = solved(trained, start, Weights.of(kept[:, ~out]), tolerance=_FOLD_TOLERANCE)
        # only the board and the angles of the frames are found anew
        judged = replace(
            problem.of(out),
            about=found.head,
            spreads=np.zeros(len(problem.spreads)),
            terms=problem.terms.of(out).held(found.state.terms),
            noisier=problem.noisier if noisier is None else noisier,
        )
        known = judged.start(solution.state.boards)._replace(bend=solution.state.bend)
        best = solved(judged, known, Weights.of(kept[:, out]), tolerance=_FOLD_TOLERANCE)
        counted = kept[:, out]
        total = np.where(counted, best.squares, 0.0).sum(axis=-1)
        count = counted.sum(axis=-1)
        views[:, out] = np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0)
        own = judged.joints.own & np.asarray(count.any(axis=0))[:, None]
        for number in np.unique(pose[out]):
            here = pose[out] == number
            corners = total[:, here].sum() / max(count[:, here].sum(), 1)
            read = (best.misread[here] ** 2)[own[here]].sum() / max(own[here].sum(), 1)
            poses[number] = corners + read if count[:, here].any() else np.nan
    return HeldOut(views, poses)
