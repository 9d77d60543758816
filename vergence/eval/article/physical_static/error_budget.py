"""Which error source does what to depth: alone by depth, and off the axis, where ITPC differs.

At a settled fixation gaze and ITPC are the same computation. They differ where the target is seen
beside the principal points, so ITPC is evaluated there: the eyes look past the target, by up to
300 px in eight directions, the same for both eyes, wherever image and joints allow it.
"""

from typing import Final, NamedTuple

import numpy as np
import pandas as pd

from vergence.eval.article.twin.fixation_errors import fix_errors
from vergence.eval.article.twin.heads import draw_heads
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.models.perturbation import ModelErrors
from vergence.triangulation import Noise, triangulate_gaze

ENCODERS: Final = "encoders"
ALL: Final = "all"
SOURCE_LABELS: Final = {
    "link_m": "link lengths",
    "coaxiality_rad": "coaxiality",
    "joint_offset_rad": "joint offsets",
    "head_eye_rad": "head-eye rotation",
    "head_eye_m": "head-eye translation",
    "focal_relative": "focal lengths",
    "principal_px": "principal points",
    "distortion": "distortion",
    "common_tilt": "common tilt",
    ENCODERS: "encoders",
}
"""The sources of error by their name in tables, and what people call them."""
BUDGET_SOURCES: Final = tuple(SOURCE_LABELS)
"""Sources that have a budget of their own; the detector's errors join them."""
_DIRECTIONS: Final = 8
_REACH_M: Final = 0.03
_PLACES: Final = 13


class BudgetCase(NamedTuple):
    """Heads and points whose depth errors are split by their sources."""

    nominal: HeadModel
    """The head that controls and triangulates."""
    errors: ModelErrors
    """Of the true heads, all sources together."""
    heads: int
    """How many true heads."""
    points: FloatArray
    """(points, 3) in N, m."""
    seed: int
    """The run's seed."""


class _Drawn(NamedTuple):
    """What one source of error does: heads that differ, or places that the encoders round."""

    heads: HeadModel
    points: FloatArray
    """(1 or n, points, 3) in N, m: n places around each point stand for n draws of rounding."""
    encoders: bool


def _draw(case: BudgetCase, source: str) -> _Drawn:
    points, errors = case.points, case.errors
    if source == ENCODERS:
        steps = np.linspace(-_REACH_M, _REACH_M, _PLACES)
        around = np.stack(np.meshgrid(steps, [0.0], steps), axis=-1).reshape(-1, 1, 3)
        return _Drawn(case.nominal, points + around, True)
    if source != ALL:
        name = "common_tilt_rad" if source == "common_tilt" else source
        errors = ModelErrors(**{name: getattr(errors, name)})
    heads = draw_heads(case.nominal, errors, case.heads, case.seed)
    return _Drawn(heads, points[None], source == ALL)


def budget_rows(case: BudgetCase, source: str) -> pd.DataFrame:
    """What one source alone does to settled fixations.

    Args:
        case: the heads and points.
        source: one of `BUDGET_SOURCES`, or `all`.

    Returns:
        A row a point: rms over the heads of the depth error, percent of depth.
    """
    nominal, points, drawn = case.nominal, case.points, _draw(case, source)
    depth = _depth(nominal, drawn, off_axis_pixels(nominal, (0.0,)))[..., 0, 0]
    return _budget(source, points, np.sqrt(np.nanmean(depth**2, axis=0)))


def detector_rows(
    nominal: HeadModel, points: FloatArray, error_px: FloatArray, source: str
) -> pd.DataFrame:
    """What an error of the detector alone does to settled fixations, to first order.

    Args:
        nominal: the head.
        points: (points, 3) in N, m.
        error_px: (points, 2, 2) rms error of the detected pixels, px.
        source: what the error is called.

    Returns:
        Rows as of `budget_rows`.
    """
    q = nominal.fixate(points, nominal.rest()[:3])
    return _budget(
        source, points, triangulate_gaze(nominal, q, Noise(pixel_px=error_px)).sigma[:, 2]
    )


def _budget(source: str, points: FloatArray, depth_error_m: FloatArray) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "case": "budget",
            "source": source,
            "point": np.arange(1, len(points) + 1),
            "truth_z_mm": 1000.0 * points[:, 2],
            "rms_depth_error_percent": 100.0 * depth_error_m / points[:, 2],
        }
    )


def off_axis_pixels(nominal: HeadModel, offsets_px: tuple[float, ...]) -> FloatArray:
    """(offsets, directions, 2, 2) raw pixels beside the principal points of both eyes."""
    angle = 2.0 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    offset = np.asarray(offsets_px)[:, None, None] * direction
    return np.asarray(nominal.cameras.principal + offset[:, :, None, :])


def off_axis_rows(
    case: BudgetCase,
    source: str,
    offsets_px: tuple[float, ...],
    excess_percent: float,
) -> pd.DataFrame:
    """ITPC beside the axis against gaze on it, with one source of error or all.

    Args:
        case: the heads and points.
        source: one of `BUDGET_SOURCES`, or `all`.
        offsets_px: distances of the target from both principal points.
        excess_percent: by how much ITPC's largest depth error exceeded gaze's in the article.

    Returns:
        A row an offset. Both rms are over the same heads, points and directions; `added` is the
        rms of their difference; `worse` the share of fixations in which ITPC's error is the
        larger; the largest depth errors are medians over heads and directions.
    """
    nominal, points, drawn = case.nominal, case.points, _draw(case, source)
    relative = 100.0 / points[:, 2, None, None]
    itpc = relative * _depth(nominal, drawn, off_axis_pixels(nominal, offsets_px))
    gaze = relative * _depth(nominal, drawn, off_axis_pixels(nominal, (0.0,)))[..., :1]
    rows = []
    for k, offset in enumerate(offsets_px):
        there = itpc[:, :, k]
        valid = np.isfinite(there)
        here = np.where(valid, gaze[:, :, 0], np.nan)
        largest = np.abs(there).max(axis=1)
        excess = largest - np.abs(gaze[:, :, 0]).max(axis=1)
        known = np.isfinite(excess)
        rows.append(
            {
                "case": "off axis",
                "source": source,
                "offset_px": float(offset),
                "gaze_rms_percent": _rms(here),
                "itpc_rms_percent": _rms(there),
                "added_rms_percent": _rms(there - here),
                "worse_share": float(np.mean(np.abs(there[valid]) > np.abs(here[valid]))),
                "possible_share": float(valid.mean()),
                "itpc_largest_percent": float(np.median(largest[known])) if known.any() else np.nan,
                "excess_share": float(np.mean(excess[known] >= excess_percent))
                if known.any()
                else np.nan,
            }
        )
    return pd.DataFrame(rows)


def _depth(nominal: HeadModel, drawn: _Drawn, pixels: FloatArray) -> FloatArray:
    """(draws, points, offsets, directions) depth errors, m."""
    heads = drawn.heads[:, None, None, None] if drawn.heads.batch_shape else drawn.heads
    points = drawn.points[:, :, None, None]
    return fix_errors(nominal, heads, points, pixels, drawn.encoders)[..., 2]


def _rms(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")


def crossover_px(rows: pd.DataFrame, margin: float) -> float:
    """From which offset on ITPC's rms depth error exceeds that of gaze by a margin.

    Args:
        rows: those of one source of `off_axis_rows`.
        margin: the margin, as a fraction of gaze's.

    Returns:
        The offset, interpolated between those evaluated, px; 0 where gaze has no error and ITPC
        has one; inf where it does not come to that.
    """
    rows = rows.sort_values("offset_px")
    offset = rows["offset_px"].to_numpy()
    gaze, itpc = rows["gaze_rms_percent"].to_numpy(), rows["itpc_rms_percent"].to_numpy()
    if gaze.max() < 1e-6 * max(itpc.max(), 1e-12):
        return 0.0
    # errors that grow with the offset add in squares, so squares are interpolated
    over = (itpc / gaze) ** 2 - (1.0 + margin) ** 2
    above = over > 0.0
    if not above[-1]:
        return float("inf")
    first = len(above) - int(np.argmin(above[::-1])) if not above.all() else 0
    if first == 0:
        return float(offset[0])
    share = -over[first - 1] / (over[first] - over[first - 1])
    near, far = offset[first - 1] ** 2, offset[first] ** 2
    return float(np.sqrt(near + share * (far - near)))
