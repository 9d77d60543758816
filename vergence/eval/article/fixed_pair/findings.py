"""What the comparison with a fixed pair says: summary rows and conclusion."""

from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd

from vergence.eval.article.experiment import SummaryRow
from vergence.eval.article.reported import Reported, reported_results, static_points
from vergence.eval.article.twin.statistics import (
    AXES,
    METHOD_LABELS,
    METHODS,
    Placement,
    lie,
    listed,
    ordinal,
    place,
    verdict,
)
from vergence.models.parts import FloatArray

NAME: Final = "versus ZED Mini"
_BASELINE_M: Final = 0.092
"""Of the head's eyes."""


def reported() -> list[Reported]:
    """The article's rows of this experiment."""
    return [r for r in reported_results() if r.experiment == NAME]


def errors(table: pd.DataFrame, method: str, axis: str) -> FloatArray:
    """(draws, points) errors against the truth, mm."""
    rows = table[(table["case"] == "fix") & (table["method"] == method)]
    wide = rows.pivot(index="draw", columns="point", values=f"error_{axis}_mm")
    return np.asarray(wide.to_numpy(), dtype=np.float64)


def differences(table: pd.DataFrame, method: str, axis: str, pair: str) -> FloatArray:
    """(draws, points) absolute differences of head and pair, mm; both methods side by side."""
    methods = METHODS if method == "both" else (method,)
    other = errors(table, pair, axis)
    return np.concatenate([np.abs(errors(table, m, axis) - other) for m in methods], axis=1)


def placements(table: pd.DataFrame, r: Reported, pair: str) -> tuple[Placement, Placement]:
    """The article's least and greatest difference among ours."""
    apart = differences(table, r.method, r.axis, pair)
    assert r.high is not None  # every row of this experiment is a range
    return place(r.low, apart.min(axis=1)), place(r.high, apart.max(axis=1))


class Misalignment(NamedTuple):
    """What pose of the pair in N would explain a range of differences along x or y."""

    low_mm: float
    high_mm: float
    turn_deg: float
    """A rotation alone that comes nearest: yaw for x, pitch for y."""
    turn_low_mm: float
    turn_high_mm: float
    """The range that it gives."""
    with_shift_deg: float
    """The rotation of a rotation and shift that give the range exactly."""
    shift_mm: float

    @property
    def misfit_mm(self) -> float:
        """Greatest difference between the article's range and that of a rotation alone."""
        return max(abs(self.turn_low_mm - self.low_mm), abs(self.turn_high_mm - self.high_mm))


def explain(r: Reported, place_z_mm: float) -> Misalignment:
    """The misalignment behind a range, if heads and pair had no other errors.

    A rotation by a small angle t shifts a point at distance z by t z, so differences grow with
    depth; nearest and farthest point are taken to be the least and the greatest.

    Args:
        r: a row of the article along x or y.
        place_z_mm: z of the pair in N.

    Returns:
        What explains it.
    """
    assert r.high is not None
    depth = 1000.0 * static_points("zed_mini")[:, 2] - place_z_mm
    near, far = float(depth.min()), float(depth.max())
    turn = (near * r.low + far * r.high) / (near**2 + far**2)
    slope = (r.high - r.low) / (far - near)
    return Misalignment(
        r.low, r.high, float(np.rad2deg(turn)), turn * near, turn * far,
        float(np.rad2deg(slope)), r.low - slope * near,
    )  # fmt: skip


def summarise(table: pd.DataFrame, config: Any) -> list[SummaryRow]:
    """Rows of the summary: medians over the draws of the least and the greatest difference."""
    del config
    rows = []
    for quantity, pair in (
        ("absolute difference", "pair"),
        ("absolute difference, pair's pose unknown", "misaligned"),
    ):
        for r in reported():
            low, high = placements(table, r, pair)
            rows.append(
                SummaryRow.of(NAME, quantity, r.method, r.axis, (r.low, r.high),
                              (low.median, high.median), verdict((low, high)))
            )  # fmt: skip
    for method in ("gaze", "itpc", "pair"):
        for axis in AXES:
            mean = np.abs(errors(table, method, axis)).mean(axis=1)
            low_, high_ = np.percentile(mean, [10.0, 90.0])
            rows.append(
                SummaryRow.of(NAME, "mean absolute error", method, axis, None,
                              (float(low_), float(high_)), "not reported")
            )  # fmt: skip
    return rows


def conclude(table: pd.DataFrame, config: Any) -> str:
    """One paragraph from the numbers."""
    return " ".join(
        [
            _of_truth(table, config),
            _of_differences(table),
            _of_pose(table, config),
            _of_methods(table),
        ]
    )


def _of_truth(table: pd.DataFrame, config: Any) -> str:
    mean = {
        m: [float(np.median(np.abs(errors(table, m, a)).mean(axis=1))) for a in AXES]
        for m in ("gaze", "pair")
    }
    ratio = mean["gaze"][2] / mean["pair"][2]
    better, worse = ("pair", "head") if ratio > 1.0 else ("head", "pair")
    factor = max(ratio, 1.0 / ratio)
    beats = np.abs(errors(table, "gaze", "z")) < np.abs(errors(table, "pair", "z"))
    sigma = table.loc[table["case"] == "detector", "sigma_px"]
    return (
        "Against the truth, mean errors in x, y, z of the median head by gaze are "
        f"{_triple(mean['gaze'])} mm and of the median pair {_triple(mean['pair'])} mm (its "
        f"detections scatter by {sigma.min():.3f} to {sigma.max():.3f} px): in depth the {better} "
        f"is {factor:.1f} times better than the {worse}, though the head is closer in "
        f"{100 * beats.mean():.0f} % of the draws and points. The pair's factory calibration is an "
        f"assumption: off by {config.calibration_rotation_deg:g} degrees of rotation and "
        f"{config.calibration_principal_px:g} px of principal point."
    )


def _triple(values: list[float]) -> str:
    return ", ".join(f"{value:.1f}" for value in values)


def _of_differences(table: pd.DataFrame) -> str:
    inside, outside = [], []
    for r in reported():
        for which, placed in zip(("least", "greatest"), placements(table, r, "pair"), strict=True):
            name = f"the {which} in {r.axis} ({_name(r)}{placed.article:g} mm"
            if placed.inside:
                inside.append(f"{name}, {ordinal(placed.percentile)})")
            else:
                outside.append(f"{name} against {placed.low:.1f} to {placed.high:.1f})")
    text = "Of the article's differences between head and pair, "
    text += f"{listed(inside)} {lie(inside)}" if inside else "none lies"
    text += " within our middle 80 %"
    if outside:
        text += f"; outside {'is' if len(outside) == 1 else 'are'} {listed(outside)}"
    text += "."
    depth = [r for r in reported() if r.axis == "z" and r.high is not None]
    if any(not placements(table, r, "pair")[1].inside for r in depth):
        far, most = static_points("zed_mini")[:, 2].max(), max(r.high or 0.0 for r in depth)
        turn = np.rad2deg(most / 1000.0 * _BASELINE_M / far**2)
        text += (
            f" {most:g} mm of depth at {far:.1f} m, if the head's alone, are {turn:.2f} degrees of "
            "vergence error, where the largest error of its static targets was 0.10."
        )
    return text


def _name(r: Reported) -> str:
    return "" if r.method == "both" else f"{METHOD_LABELS[r.method]}, "


def _of_pose(table: pd.DataFrame, config: Any) -> str:
    parts = []
    for r in reported():
        if r.axis not in ("x", "y"):
            continue
        m = explain(r, config.pair_place_mm[2])
        turned = "yaw" if r.axis == "x" else "pitch"
        fits = m.misfit_mm < 0.1 * m.high_mm
        parts.append(
            f"in {r.axis}, {m.turn_deg:.1f} degrees of {turned} alone give {m.turn_low_mm:.0f} to "
            f"{m.turn_high_mm:.0f} mm where the article has {m.low_mm:.0f} to {m.high_mm:.0f}"
            + (
                ", which is enough"
                if fits
                else f", which is not enough; {m.with_shift_deg:.1f} degrees with a shift of "
                f"{m.shift_mm:+.0f} mm would be"
            )
        )
    placed = {r: placements(table, r, "misaligned") for r in reported()}
    count = sum(p.inside for pair in placed.values() for p in pair)
    total = 2 * len(placed)
    return (
        "Differences in x and y as large as the article's say more about the pair's pose in N, "
        f"which it does not give, than about either instrument: {'; '.join(parts)}. With a pose "
        f"off by {config.mount_rotation_deg:g} degrees about each axis and "
        f"{config.mount_place_mm:g} mm along each, {count} of the {total} figures lie within our "
        "middle 80 %."
    )


def _of_methods(table: pd.DataFrame) -> str:
    gaze, itpc = (differences(table, m, "z", "pair") for m in METHODS)
    apart = np.abs(errors(table, "gaze", "z") - errors(table, "itpc", "z"))
    return (
        f"Gaze is the nearer to the pair in depth in {100 * np.mean(gaze < itpc):.0f} % of the "
        f"fixations, with a median difference between gaze and ITPC of {np.median(apart):.3f} mm: "
        "the two are the same computation there, and at a settled fixation an advantage of gaze "
        "has no cause in the methods."
    )
