"""Frames of a board in, a believable head out."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from vergence.calibration.head.adjust import HeadAdjustment, HeadSolution, State
from vergence.calibration.head.frames import HeadFrames
from vergence.calibration.head.prior import spreads_of
from vergence.calibration.head.start import started
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

LEAST_CORNERS: Final = 4
"""Of a view: fewer do not tell where the board is."""
_LEAST_POSES: Final = 6
"""Of a recording."""
_OUTLYING: Final = 9.0
"""Times the usual mean square of a view from which on it is left out."""
_FITS: Final = 4
_MOST_LEFT_OUT: Final = 0.4
"""Share of the views beyond which too many are left out for the rest to be believed."""
FOLDS: Final = 5
_FOLD_TOLERANCE: Final = 1.0
"""Change of the cost below which a fold's head is near enough."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HeadCalibration:
    """A head as a recording says that it is."""

    solution: HeadSolution
    kept: NDArray[np.bool_]
    """(2, f) the views that went in."""
    held_out: FloatArray
    """(2, f) mean squares, over sigma, of views by heads that did not know them; nan without."""
    remarks: tuple[str, ...] = ()

    @property
    def about(self) -> HeadModel:
        """The head as its file has it."""
        return self.solution.problem.about

    @property
    def head(self) -> HeadModel:
        """The calibrated head."""
        return self.solution.head

    @property
    def frames(self) -> HeadFrames:
        """What it saw."""
        return self.solution.problem.frames

    @cached_property
    def covariance(self) -> FloatArray:
        """(p, p) of the numbers of `HeadModel.parameters`."""
        return self.solution.covariance * max(self.solution.noise, 1.0) ** 2

    @property
    def sigma(self) -> FloatArray:
        """(p,) their standard deviations."""
        return np.sqrt(np.diagonal(self.covariance))


def calibrate_head(
    head: HeadModel,
    frames: HeadFrames,
    *,
    cameras: bool = True,
    progress: Callable[[float], None] | None = None,
) -> HeadCalibration:
    """Find a head's joints, eyes and cameras from frames of a board.

    Args:
        head: as its file has it.
        frames: what it saw while it moved.
        cameras: whether focal lengths, principal points and lenses may change, too.
        progress: called with the fraction done.

    Raises:
        ConfigurationError: the frames give no calibration; the message says why.
    """
    report = progress or _ignore
    if not head.actuation.count:
        raise ConfigurationError(
            f"expected a head whose eyes move, got {head.name!r}, a fixed pair: vergence calibrate "
            "stereo is for such"
        )
    frames = tidy(frames)
    _refuse_few(frames)
    frames, boards = started(head, frames)
    problem = HeadAdjustment(head, spreads_of(head, cameras), frames)
    enough = frames.seen.sum(axis=-1) >= LEAST_CORNERS
    solution, kept = _fitted(problem, problem.start(boards), enough, report)
    report(0.7)
    held_out = _held_out(solution, kept)
    report(1.0)
    return HeadCalibration(solution=solution, kept=kept, held_out=held_out)


def tidy(frames: HeadFrames) -> HeadFrames:
    """The frames in the order of time, without those that show nothing, or the same again."""
    order = np.argsort(frames.time_s, kind="stable")
    frames = frames.of(order)
    shown = (frames.seen.sum(axis=-1) >= LEAST_CORNERS).any(axis=0)
    known: set[bytes] = set()
    fresh = []
    for frame in range(len(frames.time_s)):
        content = frames.pixels[:, frame].tobytes() + frames.positions[frame].tobytes()
        fresh.append(content not in known)
        known.add(content)
    return frames.of(shown & np.array(fresh, dtype=bool))


def _refuse_few(frames: HeadFrames) -> None:
    poses = len(np.unique(frames.pose)) if len(frames.time_s) else 0
    if poses < _LEAST_POSES:
        raise ConfigurationError(
            f"expected a recording of at least {_LEAST_POSES} poses that show the board, better "
            f"60, got {poses}: turn the eyes, and the neck, to other angles between the frames"
        )


def _fitted(
    problem: HeadAdjustment,
    start: State,
    enough: NDArray[np.bool_],
    report: Callable[[float], None],
) -> tuple[HeadSolution, NDArray[np.bool_]]:
    """The best head, and the views that go with it."""
    try:
        solution = problem.solved(start, enough.astype(float), robust=True)
        kept = enough
        for number in range(_FITS):
            report(0.2 + 0.1 * number)
            views = solution.normal.views
            usual = max(float(np.median(views[kept])), 1.0)
            chosen = enough & (np.nan_to_num(views, nan=np.inf) < _OUTLYING * usual)
            if number and np.array_equal(chosen, kept):
                break
            kept = chosen
            solution = problem.solved(solution.state, kept.astype(float))
    except np.linalg.LinAlgError:
        raise ConfigurationError(
            "expected frames that tell where the board is, got some that do not: does the target "
            "have that size, and do the joint angles belong to the images?"
        ) from None
    return solution, kept


def _held_out(solution: HeadSolution, kept: NDArray[np.bool_]) -> FloatArray:
    """(2, f) mean squares of views by heads that were found without their poses."""
    problem, pose = solution.problem, solution.problem.frames.pose
    found = np.full(kept.shape, np.nan)
    fold = pose * FOLDS // (int(pose.max()) + 1)
    for each in range(FOLDS):
        out = fold == each
        trained = problem.of(~out)
        start = trained.start(solution.state.boards)._replace(
            values=solution.state.values, bend=solution.state.bend
        )
        head = trained.solved(start, kept[:, ~out].astype(float), tolerance=_FOLD_TOLERANCE).head
        # only the board and the angles of the frames are found anew
        judged = HeadAdjustment(head, np.zeros(len(problem.spreads)), problem.frames.of(out))
        known = judged.start(solution.state.boards)._replace(bend=solution.state.bend)
        normal = judged.solved(known, kept[:, out].astype(float), tolerance=_FOLD_TOLERANCE).normal
        found[:, out] = np.where(kept[:, out], normal.views, np.nan)
    return found


def _ignore(fraction: float) -> None:
    """Show no progress."""


def document(found: HeadCalibration) -> dict[str, Any]:
    """The result as plain values."""
    names = found.about.parameters().names
    return {
        "views": int(found.kept.sum()),
        "left_out": int((found.frames.seen.any(axis=-1) & ~found.kept).sum()),
        "poses": int(found.frames.pose.max()) + 1,
        "noise": found.solution.noise,
        "numbers": dict(zip(names, found.solution.state.values.tolist(), strict=True)),
        "sigma": dict(zip(names, found.sigma.tolist(), strict=True)),
    }
