"""Frames of a board in, a believable head out."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vergence.calibration.adjustment import Poses, rms
from vergence.calibration.head.adjust import HeadAdjustment, State, Weights
from vergence.calibration.head.checks import (
    refuse_exchanged,
    refuse_few,
    refuse_implausible,
    refuse_still,
    say_size,
)
from vergence.calibration.head.frames import HeadFrames
from vergence.calibration.head.moved import another_place
from vergence.calibration.head.prior import spreads_of
from vergence.calibration.head.solution import FIRST_USUAL, HeadSolution, solved
from vergence.calibration.head.start import LEAST_CORNERS, started
from vergence.calibration.head.uncertainty import head_covariance
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.joints import NECK
from vergence.models.parts import FloatArray

_OUTLYING: Final = 5.0
"""Deviations beyond which a corner, or an angle that was read, is wrong."""
_HALF: Final = 0.5
"""Share of a view's corners that have to be right for any of them to count."""
_FITS: Final = 6
_NOISIER: Final = 1.3
"""Times their deviation by steps and play that readings must scatter before it counts."""
_SAME_SCATTER: Final = 0.05
"""Relative change of a scatter that changes nothing."""
_MOST_PLACES: Final = 8
FOLDS: Final = 5
_FOLD_TOLERANCE: Final = 1.0
"""Change of the cost below which a fold's head is near enough."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HeadCalibration:
    """A head as a recording says that it is."""

    solution: HeadSolution
    kept: NDArray[np.bool_]
    """(2, f, n) the corners that went in."""
    held_out: FloatArray
    """(2, f) mean squares, over sigma, of views by heads that did not know them; nan without."""
    remarks: tuple[str, ...]
    """What a person should know, a line each."""

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

    @property
    def views(self) -> NDArray[np.bool_]:
        """(2, f) the views that went in."""
        return np.asarray(self.kept.any(axis=-1))

    @cached_property
    def rms_px(self) -> float:
        """Root mean square of what is left of the corners that went in, as lengths."""
        left = self.solution.normal.residuals * self.frames.sigma
        return rms(left[self.kept])

    @cached_property
    def rms_heldout_px(self) -> float:
        """The same of views by heads that did not know them."""
        mean = np.nanmean(self.held_out) if np.isfinite(self.held_out).any() else np.nan
        sigma = self.frames.sigma[self.kept]
        return float(np.sqrt(2.0 * mean * np.mean(sigma**2)))

    @cached_property
    def covariance(self) -> FloatArray:
        """(p, p) of the numbers of `HeadModel.parameters`."""
        return head_covariance(self.solution)

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
    refuse_still(head)
    frames = tidy(frames)
    refuse_few(frames)
    remarks: list[str] = []
    try:
        start = started(head, frames)
        refuse_exchanged(head, frames, start)
        report(0.1)
        problem = HeadAdjustment(head, spreads_of(head, cameras), start.frames)
        fit = fitted(problem, start.boards, start.agree)
        for place in range(1, _MOST_PLACES):
            report(0.1 + 0.6 * place / (place + 1.0))
            more = another_place(fit.solution, fit.kept)
            if more is None:
                break
            remarks.append(more.remark)
            problem = replace(fit.solution.problem, frames=more.frames)
            fit = fitted(problem, more.boards, more.agree, fit.solution.state)
        refuse_implausible(fit.solution, fit.kept)
        report(0.8)
        held_out = _held_out(fit.solution, fit.kept)
    except np.linalg.LinAlgError:
        raise ConfigurationError(
            "expected frames that agree on where the board is, got some that do not: is the target "
            "of that size, and do the joint angles belong to the images, with the head's signs and "
            "zeros?"
        ) from None
    report(1.0)
    return HeadCalibration(
        solution=fit.solution,
        kept=fit.kept,
        held_out=held_out,
        remarks=(*remarks, *_noisy(fit.solution), *say_size(fit.solution)),
    )


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


@dataclass(frozen=True, eq=False)
class Fit:
    """A head, and the corners that go with it."""

    solution: HeadSolution
    kept: NDArray[np.bool_]
    """(2, f, n)"""


def fitted(
    problem: HeadAdjustment, boards: Poses, agree: NDArray[np.bool_], near: State | None = None
) -> Fit:
    """The best head, and the corners that go with it."""
    enough = problem.frames.seen & (problem.frames.seen.sum(axis=-1) >= LEAST_CORNERS)[..., None]
    begin = problem.start(boards)
    if near is not None:
        begin = begin._replace(values=near.values, bend=near.bend)
    first = Weights.of(enough & agree[..., None])
    solution = solved(problem, begin, first, usual=FIRST_USUAL)
    if not agree[enough.any(axis=-1)].all():  # those that lay elsewhere through the head's file
        usual = solution.weights.usual
        solution = solved(problem, solution.state, Weights.of(enough), usual=usual)
    kept, noisier = np.zeros_like(enough), np.ones(7)
    for _ in range(_FITS):
        before = kept, noisier
        noisier = scatter_of(solution)
        kept = _going_together(solution, enough, noisier)
        if np.array_equal(kept, before[0]) and np.allclose(noisier, before[1], rtol=_SAME_SCATTER):
            break
        if not kept.any():
            raise np.linalg.LinAlgError("expected views that go together, got none")
        problem = replace(problem, noisier=noisier)
        solution = solved(problem, solution.state, Weights.of(kept))
    return Fit(solution, kept)


def _going_together(
    solution: HeadSolution, enough: NDArray[np.bool_], noisier: FloatArray
) -> NDArray[np.bool_]:
    """(2, f, n) the corners that fit, of views most of whose corners and whose angles do."""
    usual = _usual(solution, enough)
    fit = enough & (np.nan_to_num(solution.squares, nan=np.inf) < _OUTLYING**2 * usual)
    already = solution.problem.noisier
    known = np.ones(7) if already is None else already
    wrong = np.abs(solution.misread) * known / noisier > _OUTLYING * np.sqrt(usual)
    moved = np.abs(solution.problem.to_joints) > 0.0
    for eye in range(2):
        joints = moved[[3 + 2 * eye, 4 + 2 * eye]].any(axis=0)
        fit[eye] &= ~np.asarray((wrong & joints).any(axis=1))[:, None]
    most = fit.sum(axis=-1) >= np.maximum(_HALF * enough.sum(axis=-1), LEAST_CORNERS)
    # a wrong view of one eye pulls at the neck, too
    most &= ~(most.all(axis=0) & np.asarray(wrong[:, NECK].any(axis=1)))
    return np.asarray(fit & np.asarray(most)[..., None])


def _usual(solution: HeadSolution, enough: NDArray[np.bool_]) -> float:
    """Mean square of the residuals of a usual corner, in units of sigma; 1 at least.

    With most of the views wrong, a robust fit knows better than their median.
    """
    counted = enough & (solution.weights.corners > 0.0)
    return min(max(float(np.median(solution.squares[counted])), 1.0), solution.weights.usual)


def scatter_of(solution: HeadSolution) -> FloatArray:
    """(7,) how many times what steps and play say the readings of each actuator scatter; >= 1."""
    own, already = solution.problem.joints, solution.problem.noisier
    known = np.ones(7) if already is None else already
    found = np.ones(7)
    counted = np.asarray((solution.weights.corners > 0.0).any(axis=(0, 2)))
    usual_corner = _usual(solution, solution.problem.frames.seen)
    for joint in range(7):
        used = own.own[:, joint] & counted
        squares = solution.misread[used, joint] ** 2
        if len(squares) < _LEAST_READINGS:
            continue
        # of a normal or an even distribution, a few wrong readings left out
        usual = np.mean(squares[squares <= _OUTLYING**2 * max(float(np.median(squares)), 1e-12)])
        expected = max(float(np.mean(1.0 - solution.angle_left[used, joint])), 0.1)
        times = float(np.sqrt(usual / expected)) * known[joint]
        # noise of the corners makes readings look wrong as well
        found[joint] = times if times > _NOISIER * np.sqrt(usual_corner) else 1.0
    return found


_LEAST_READINGS: Final = 20
"""Of an actuator, to tell how they scatter."""


def _noisy(solution: HeadSolution) -> list[str]:
    """Lines on joints whose readings scatter more than their steps say."""
    noisier, sigma = solution.problem.noisier, solution.problem.joints.sigma
    if noisier is None:
        return []
    names = [*solution.problem.about.joints[:3], *solution.problem.about.actuation.names]
    wide = [joint for joint in range(len(names)) if noisier[joint] > 1.0]
    if not wide:
        return []
    worst = max(wide, key=lambda joint: noisier[joint])
    return [
        f"the readings of {', '.join(names[joint] for joint in wide)} scatter more than their "
        f"steps and play explain, those of {names[worst]} by {np.rad2deg(sigma[worst]):.2g} "
        f"degrees, {noisier[worst]:.1f} times as much: is there more play, did the joints rest, "
        "and do the angles belong to the images?"
    ]


def _held_out(solution: HeadSolution, kept: NDArray[np.bool_]) -> FloatArray:
    """(2, f) mean squares of views by heads that were found without their poses."""
    problem, pose = solution.problem, solution.problem.frames.pose
    found = np.full(kept.shape[:2], np.nan)
    fold = pose * FOLDS // (int(pose.max()) + 1)
    for each in range(FOLDS):
        out = fold == each
        if not kept[:, out].any() or not kept[:, ~out].any():
            continue
        trained = problem.of(~out)
        start = trained.start(solution.state.boards)._replace(
            values=solution.state.values, bend=solution.state.bend
        )
        head = solved(trained, start, Weights.of(kept[:, ~out]), tolerance=_FOLD_TOLERANCE).head
        # only the board and the angles of the frames are found anew
        judged = replace(
            problem,
            about=head,
            spreads=np.zeros(len(problem.spreads)),
            frames=problem.frames.of(out),
        )
        known = judged.start(solution.state.boards)._replace(bend=solution.state.bend)
        squares = solved(judged, known, Weights.of(kept[:, out]), tolerance=_FOLD_TOLERANCE).squares
        counted = kept[:, out]
        total = np.where(counted, squares, 0.0).sum(axis=-1)
        count = counted.sum(axis=-1)
        found[:, out] = np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0)
    return found


def _ignore(fraction: float) -> None:
    """Show no progress."""
