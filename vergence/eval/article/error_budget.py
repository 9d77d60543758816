"""Error budget of depth: each error source alone, at settled fixations and for ITPC off the axis.

At a settled fixation gaze and ITPC are the same computation. They differ if the target is imaged
away from the principal points, so ITPC is evaluated there: the eyes look past the target by up to
300 px in eight directions, equal for both eyes, as far as image and joint limits allow.
"""

from typing import Final, NamedTuple

import numpy as np
import pandas as pd

from vergence.eval.article.twin import draw_heads, mean_fix_errors_m
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.models.perturbation import ModelErrors
from vergence.triangulation import Noise, triangulate_gaze

ENCODERS: Final = "encoders"
ALL: Final = "all"
SOURCES: Final = {
    "link_m": ("link lengths", "links"),
    "coaxiality_rad": ("coaxiality", "coaxiality"),
    "joint_offset_rad": ("joint offsets", "joint offsets"),
    "head_eye_rad": ("head-eye rotation", "head-eye turn"),
    "head_eye_m": ("head-eye translation", "head-eye shift"),
    "focal_relative": ("focal lengths", "focal length"),
    "principal_px": ("principal points", "principal point"),
    "distortion": ("distortion", "distortion"),
    "common_tilt": ("common tilt", "common tilt"),
    ENCODERS: ("encoders", "encoders"),
}
"""Titles, long and short, of the sources evaluated one at a time here, by their names in tables;
those of the detector are added by `detector_rows`."""
_DIRECTIONS: Final = 8
"""Number of directions in which the eyes look past the target (numerical)."""
_REACH_M: Final = 0.03
"""Half side, in x and z, of the grid around a point that samples encoder quantisation, m (chosen:
spans several encoder steps, small beside the depth)."""
_PLACES: Final = 13
"""Points per side of that grid (numerical)."""


class BudgetCase(NamedTuple):
    """Heads and points of an error budget."""

    nominal: HeadModel
    """The head used for control and triangulation."""
    errors: ModelErrors
    """Standard deviations of the true heads' model errors, all sources."""
    heads: int
    """Number of true heads."""
    points: FloatArray
    """(points, 3) in N, m."""
    seed: int
    """The run's seed."""


def _depth_errors_m(case: BudgetCase, source: str, offsets_px: tuple[float, ...]) -> FloatArray:
    """(draws, points, offsets, directions) depth errors, m.

    The draws are heads or, for the encoders' quantisation, places around each point.
    """
    nominal, points, errors = case.nominal, case.points[None], case.errors
    if source == ENCODERS:
        steps, heads = np.linspace(-_REACH_M, _REACH_M, _PLACES), nominal
        points = points + np.stack(np.meshgrid(steps, [0.0], steps), axis=-1).reshape(-1, 1, 3)
    else:
        if source != ALL:
            name = "common_tilt_rad" if source == "common_tilt" else source
            errors = ModelErrors(**{name: getattr(errors, name)})
        heads = draw_heads(nominal, errors, case.heads, case.seed)[:, None, None, None]
    pixels, encoders = off_axis_pixels(nominal, offsets_px), source in {ENCODERS, ALL}
    return mean_fix_errors_m(nominal, heads, points[:, :, None, None], pixels, encoders)[..., 2]


def budget_rows(case: BudgetCase, source: str) -> pd.DataFrame:
    """A row per point: rms depth error of settled fixations with one source or all, percent."""
    depth = _depth_errors_m(case, source, (0.0,))[..., 0, 0]
    return _budget(source, case.points, np.sqrt(np.nanmean(depth**2, axis=0)))


def detector_rows(
    nominal: HeadModel, points: FloatArray, error_px: FloatArray, source: str
) -> pd.DataFrame:
    """Rows as of `budget_rows` for detector errors (points, 2, 2), px, to first order."""
    q = nominal.fixate(points, nominal.rest()[:3])
    sigma = triangulate_gaze(nominal, q, Noise(pixel_px=error_px)).sigma
    return _budget(source, points, sigma[:, 2])


def _budget(source: str, points: FloatArray, depth_error_m: FloatArray) -> pd.DataFrame:
    return pd.DataFrame({
        "case": "budget", "source": source, "point": np.arange(1, len(points) + 1),
        "truth_z_mm": 1000.0 * points[:, 2],
        "rms_depth_error_percent": 100.0 * depth_error_m / points[:, 2],
    })  # fmt: skip


def off_axis_pixels(nominal: HeadModel, offsets_px: tuple[float, ...]) -> FloatArray:
    """(offsets, directions, 2, 2) raw pixels at offsets from the principal points of both eyes."""
    angle = 2.0 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    offset = np.asarray(offsets_px)[:, None, None] * direction
    return np.asarray(nominal.cameras.principal + offset[:, :, None, :])


def off_axis_rows(
    case: BudgetCase, source: str, offsets_px: tuple[float, ...], excess_percent: float
) -> pd.DataFrame:
    """Compare ITPC off the optical axis with gaze on it, with one error source or all.

    A row per offset. Both rms are over the same heads, points and directions. `added` is the rms of
    their difference, `worse` the fraction of fixations in which ITPC's error is larger, `possible`
    the fraction within image and joint limits, and `excess` the fraction of heads and directions in
    which ITPC's largest error exceeds that of gaze by `excess_percent` or more. The largest depth
    error is the median over heads and directions.
    """
    relative = 100.0 / case.points[:, 2, None, None]
    itpc = relative * _depth_errors_m(case, source, offsets_px)
    gaze = relative * _depth_errors_m(case, source, (0.0,))[..., :1]
    rows = []
    for k, offset in enumerate(offsets_px):
        there = itpc[:, :, k]
        valid = np.isfinite(there)
        here = np.where(valid, gaze[:, :, 0], np.nan)
        largest = np.abs(there).max(axis=1)
        excess = largest - np.abs(gaze[:, :, 0]).max(axis=1)
        known = np.isfinite(excess)
        typical, share = np.nan, np.nan
        if known.any():
            typical = float(np.median(largest[known]))
            share = float(np.mean(excess[known] >= excess_percent))
        row = {
            "case": "off axis", "source": source, "offset_px": float(offset),
            "gaze_rms_percent": _rms(here), "itpc_rms_percent": _rms(there),
            "added_rms_percent": _rms(there - here),
            "worse_share": float(np.mean(np.abs(there[valid]) > np.abs(here[valid]))),
            "possible_share": float(valid.mean()), "itpc_largest_percent": typical,
            "excess_share": share,
        }  # fmt: skip
        rows.append(row)
    return pd.DataFrame(rows)


def _rms(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")


def crossover_px(rows: pd.DataFrame, margin: float) -> float:
    """Offset beyond which ITPC's rms depth error exceeds that of gaze by a fraction, px.

    It is interpolated; 0 if gaze has no error; inf if the margin is not exceeded at the largest
    offset.
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
