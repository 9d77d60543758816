"""What the static targets on the simulated rig come to, beside the article's figures."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd

from vergence.eval.article.common.closed_loop import gaze_uncertainty
from vergence.eval.article.common.simulated_cases import CASES
from vergence.eval.article.reported import Reported, reported_results, static_points
from vergence.models.files.head_file import load_head
from vergence.models.parts import FloatArray

EXPERIMENT: Final = "simulated static"
"""The name in the article's reported results."""
ARTICLE_CASE: Final = "principal"
"""The case that stands for the article's rig: Table 2's camera matrix on a centred image."""
ARTICLE_Z_PERCENT: Final = 0.5
"""Greatest absolute error in z that the article reports, per cent of depth."""
ARTICLE_DETECTION_PX: Final = (0.006, 0.057)
"""The article's sample standard deviations of its detections."""
Z_WORST_PERCENT: Final = 0.4
Z_MEDIAN_PERCENT: Final = 0.1
XY_WORST_MM: Final = 0.3
"""What we want of the exact model after averaging; of a dithered fixation, half of it."""


def reported(quantity: str, axis: str) -> Reported:
    """What the article reports of this experiment, the first row that fits."""
    return next(
        row
        for row in reported_results()
        if (row.experiment, row.quantity, row.axis) == (EXPERIMENT, quantity, axis)
    )


def select(
    table: pd.DataFrame, case: str, fixation: str = "still", images: str = "rendered"
) -> pd.DataFrame:
    """The rows of one case and kind of fixation."""
    chosen = (table["case"] == case) & (table["fixation"] == fixation) & (table["images"] == images)
    return table[chosen]


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Absolute errors of the mean fixes of one case, over points and methods."""

    low_mm: dict[str, float]
    """By axis."""
    high_mm: dict[str, float]
    z_percent: tuple[float, float, float]
    """Error in z over depth, %: least, median, greatest."""

    @staticmethod
    def of(rows: pd.DataFrame) -> "Errors":
        """The errors of some rows."""
        absolute = rows["error_mm"].abs()
        by_axis = absolute.groupby(rows["axis"])
        deep = rows["axis"] == "z"
        share = 100.0 * absolute[deep] / rows["depth_mm"][deep]
        return Errors(
            low_mm={axis: float(by_axis.min()[axis]) for axis in "xyz"},
            high_mm={axis: float(by_axis.max()[axis]) for axis in "xyz"},
            z_percent=(float(share.min()), float(share.median()), float(share.max())),
        )

    def meets(self, factor: float = 1.0) -> bool:
        """Whether all targets times a factor are met."""
        return (
            self.z_percent[2] <= factor * Z_WORST_PERCENT
            and self.z_percent[1] <= factor * Z_MEDIAN_PERCENT
            and max(self.high_mm["x"], self.high_mm["y"]) <= factor * XY_WORST_MM
        )


@dataclass(frozen=True, kw_only=True)
class Findings:
    """The numbers that summary and conclusion share."""

    errors: dict[str, Errors]
    """By case, still fixations."""
    dithered: Errors
    """The exact model, dithered."""
    sigma_px: tuple[float, float]
    """Least and greatest sample standard deviation of the detections."""
    bias_px: float
    """Greatest bias of the detector at a point, of either eye and axis, exact model."""
    still_se: float
    """Greatest error of an exact model's mean of ITPC over its standard error, still."""
    dithered_se: float
    """The same, dithered."""
    scatter_ratio: float
    """Scatter of gaze over that of ITPC along z, median over the points, exact model."""
    difference_mm: float
    """Greatest difference of the two methods' means, along any axis, in any case."""
    difference_se: float
    """Greatest difference of their means over the standard error of ITPC's."""
    implied_px: dict[str, tuple[float, float]]
    """The detection noise that the article's extreme uncertainties imply, by axis."""
    drawn_both: float
    """Share of drawn heads as far off in x as the article's at its worst, within a factor of two,
    and not farther off in z than the article's at its worst."""
    drawn_ratio: float
    """Error in z over error in x at the farthest point, median over the drawn heads."""


def find(table: pd.DataFrame) -> Findings:
    """The findings of a table."""
    still = {case: select(table, case) for case in CASES if len(select(table, case))}
    exact = still["exact"]
    columns = [name for name in table.columns if name.startswith("detection_")]
    sigma = exact[[name for name in columns if "sigma" in name]]
    bias = exact[[name for name in columns if "bias" in name]]
    rendered = pd.concat(still.values())
    wide = rendered.pivot_table(
        index=["case", "point", "axis"], columns="method", values="error_mm"
    )
    difference = wide["gaze"] - wide["itpc"]
    itpc = rendered[rendered["method"] == "itpc"].set_index(["case", "point", "axis"])
    error = itpc["standard_deviation_mm"] / np.sqrt(itpc["n"])
    scatter = exact[exact["axis"] == "z"].pivot_table(
        index="point", columns="method", values="standard_deviation_mm"
    )
    both, ratio = _drawn(select(table, "drawn", images="none"))
    return Findings(
        errors={case: Errors.of(rows) for case, rows in still.items()},
        dithered=Errors.of(select(table, "exact", "dithered")),
        sigma_px=(float(sigma.to_numpy().min()), float(sigma.to_numpy().max())),
        bias_px=float(bias.abs().to_numpy().max()),
        still_se=_standard_errors(exact),
        dithered_se=_standard_errors(select(table, "exact", "dithered")),
        scatter_ratio=float((scatter["gaze"] / scatter["itpc"]).median()),
        difference_mm=float(difference.abs().max()),
        difference_se=float((difference.abs() / error).max()),
        implied_px=implied_noise_px(),
        drawn_both=both,
        drawn_ratio=ratio,
    )


def _standard_errors(rows: pd.DataFrame) -> float:
    """The greatest error of a mean over what its single fixes' scatter says, ITPC."""
    own = rows[rows["method"] == "itpc"]
    return float((own["error_mm"].abs() * np.sqrt(own["n"]) / own["standard_deviation_mm"]).max())


def _drawn(heads: pd.DataFrame) -> tuple[float, float]:
    """How the drawn heads' errors compare with the article's x and z together."""
    absolute = heads.assign(error_mm=heads["error_mm"].abs())
    worst = absolute.pivot_table(index="head", columns="axis", values="error_mm", aggfunc="max")
    share = (
        absolute[absolute["axis"] == "z"]
        .assign(share=lambda rows: 100.0 * rows["error_mm"] / rows["depth_mm"])
        .groupby("head")["share"]
        .max()
    )
    article_x = reported("absolute error", "x").high or 0.0
    like = (worst["x"] >= 0.5 * article_x) & (worst["x"] <= 2.0 * article_x)
    far = absolute[absolute["point"] == absolute["point"].max()]
    last = far.pivot_table(index="head", columns="axis", values="error_mm")
    both = like & (share <= ARTICLE_Z_PERCENT)
    return float(both.mean()), float((last["z"] / last["x"]).median())


def unit_uncertainty_mm() -> FloatArray:
    """(21, 3) the uncertainty at Table 3's points for one pixel of detection noise, mm/px."""
    head, points = load_head("simulated"), static_points("simulated")
    return gaze_uncertainty(head, head.fixate(points), np.ones((len(points), 2, 2)))


def implied_noise_px() -> dict[str, tuple[float, float]]:
    """The detection noise that each extreme of Fig. 7 implies, px by axis.

    The least uncertainty belongs to the nearest point and the greatest to the farthest.
    """
    unit = unit_uncertainty_mm()
    implied = {}
    for axis, letter in enumerate("xyz"):
        row = reported("uncertainty", letter)
        implied[letter] = (
            float(row.low / unit[0, axis]),
            float((row.high or row.low) / unit[-1, axis]),
        )
    return implied
