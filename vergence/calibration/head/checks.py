"""Checks of recordings: refusals with advice if they cannot calibrate a head, and remarks."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from vergence.calibration.head.frames import HeadFrames
from vergence.calibration.head.solution import HeadSolution
from vergence.calibration.head.start import (
    LEAST_CORNERS,
    InitialBoardPoses,
    estimate_consensus_board_poses,
)
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.parts import EYE_NAMES

_LEAST_POSES: Final = 6
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
    if poses < _LEAST_POSES:
        raise ConfigurationError(
            f"expected a recording of at least {_LEAST_POSES} poses that show the board, better "
            f"60, got {poses}: turn the eyes, and the neck, to other angles between the frames"
        )


def refuse_swapped_eyes(head: HeadModel, frames: HeadFrames, start: InitialBoardPoses) -> None:
    """Refuse a recording with the images of the left and right eye exchanged."""
    both = (frames.seen.sum(axis=-1) >= LEAST_CORNERS).all(axis=0)
    if not both.any():
        return
    some = frames.select(both)
    exchanged = HeadFrames(
        target=some.target, time_s=some.time_s, joint_positions=some.joint_positions,
        pixels=some.pixels[::-1], sigma=some.sigma[::-1], placement=some.placement,
    )  # fmt: skip
    if (
        estimate_consensus_board_poses(head, exchanged).spread_m
        < _SWAPPED_SPREAD_RATIO * start.spread_m
    ):
        raise ConfigurationError(
            "expected the left eye's images as the left ones, got images that go with each other "
            "if left and right are exchanged"
        )


def refuse_implausible_solution(solution: HeadSolution, kept_corners: NDArray[np.bool_]) -> None:
    """Refuse a fit with mostly outliers or few poses, and a head far from its file."""
    frames = solution.problem.frames
    views = (frames.seen.sum(axis=-1) >= LEAST_CORNERS).sum()
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
    away = (solution.state.head_parameters - problem.prior_mean) / np.where(
        problem.prior_sigma > 0.0, problem.prior_sigma, np.inf
    )
    worst = int(np.abs(away).argmax())
    if abs(away[worst]) > _MOST_PRIOR_SIGMAS:
        names, units, _ = problem.nominal_head.parameters()
        step = solution.state.head_parameters[worst] - problem.prior_mean[worst]
        raise ConfigurationError(
            f"expected a head that is like its file, got one whose {names[worst]} is "
            f"{_said(step, units[worst])} off, where "
            f"{_said(problem.prior_sigma[worst], units[worst])} are usual: is the board of the "
            "stated size, and do the angles' signs and zeros go with the file?"
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
        views = int((frames.seen[eye].sum(axis=-1) >= LEAST_CORNERS).sum())
        out = views - int(kept_corners[eye].any(axis=-1).sum())
        if not views:
            lines.append(f"the {name} eye has never seen the board: it stays as its file has it")
        elif out > _MANY_LEFT_OUT_FRACTION * views:
            lines.append(
                f"{out} of {views} views of the {name} eye do not go with the others and are left "
                "out: do they show the board, at the same time as the other eye's?"
            )
    return lines


def _said(value: float, unit: str) -> str:
    """Format a number with degrees, mm or px."""
    scale, name = {"rad": (180.0 / np.pi, " degrees"), "m": (1e3, " mm"), "px": (1.0, " px")}.get(
        unit, (1.0, "")
    )
    return f"{scale * value:.3g}{name}"
