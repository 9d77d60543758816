"""What the static targets on the simulated rig come to, beside the article's figures."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd

from vergence.eval.article import Reported, reported_results, static_points
from vergence.eval.experiment import SummaryRow, compare
from vergence.eval.experiments.closed_loop import gaze_uncertainty
from vergence.eval.experiments.simulated_cases import CASES
from vergence.eval.experiments.simulated_static_trials import SimulatedStaticConfig
from vergence.models.head_file import load_head
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
_UNREPORTED: Final = "not reported"


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
    scatter_ratio: float
    """Scatter of gaze over that of ITPC along z, median over the points, exact model."""
    difference_mm: float
    """Greatest difference of the two methods' means, along any axis, in any case."""
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
    scatter = exact[exact["axis"] == "z"].pivot_table(
        index="point", columns="method", values="standard_deviation_mm"
    )
    both, ratio = _drawn(select(table, "drawn", images="none"))
    return Findings(
        errors={case: Errors.of(rows) for case, rows in still.items()},
        dithered=Errors.of(select(table, "exact", "dithered")),
        sigma_px=(float(sigma.to_numpy().min()), float(sigma.to_numpy().max())),
        bias_px=float(bias.abs().to_numpy().max()),
        scatter_ratio=float((scatter["gaze"] / scatter["itpc"]).median()),
        difference_mm=float((wide["gaze"] - wide["itpc"]).abs().max()),
        implied_px=implied_noise_px(),
        drawn_both=both,
        drawn_ratio=ratio,
    )


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


def summarise(table: pd.DataFrame, config: SimulatedStaticConfig) -> list[SummaryRow]:
    """The article's rows under its own camera matrix, then those of the other cases and targets.

    Verdicts beyond `reproduced`, `smaller` and `larger`: `target met` or `target missed` for what
    we want of the exact model, `inside` or `outside` the article's own range of detection noise,
    and `not reported` where the article has no figure.
    """
    found = find(table)
    rows = [_reported(row, select(table, ARTICLE_CASE)) for row in reported_results()
            if row.experiment == EXPERIMENT]  # fmt: skip
    for case, errors in found.errors.items():
        title = CASES[case].title
        rows.append(_depth_share(f"absolute error over depth, {title}", errors))
        if case != ARTICLE_CASE:
            rows += _case_errors(f"absolute error, {title}", errors)
    rows += _case_errors("absolute error, exact model, dithered", found.dithered)
    rows.append(_depth_share("absolute error over depth, exact model, dithered", found.dithered))
    rows += _targets("exact model", found.errors["exact"], 1.0)
    rows += _targets("exact model, dithered", found.dithered, 0.5)
    low, high = found.sigma_px
    rows.append(
        _row("detection noise", "both", "u, v", "px", low, high,
             compare(low, high, *ARTICLE_DETECTION_PX), ARTICLE_DETECTION_PX)
    )  # fmt: skip
    for axis, (low, high) in found.implied_px.items():
        inside = ARTICLE_DETECTION_PX[0] <= min(low, high) and (
            max(low, high) <= ARTICLE_DETECTION_PX[1]
        )
        rows.append(
            _row("detection noise implied by the article's uncertainty", "both", axis, "px",
                 min(low, high), max(low, high), "inside" if inside else "outside",
                 ARTICLE_DETECTION_PX)
        )  # fmt: skip
    exact = select(table, "exact")
    for method in ("gaze", "itpc"):
        for axis in "xyz":
            own = exact[(exact["method"] == method) & (exact["axis"] == axis)]
            spread = own["standard_deviation_mm"]
            rows.append(
                _row("standard deviation of single fixes", method, axis, "mm",
                     float(spread.min()), float(spread.max()), _UNREPORTED)
            )  # fmt: skip
    return rows


def _reported(row: Reported, case: pd.DataFrame) -> SummaryRow:
    """Ours beside one figure of the article's."""
    own = case[case["axis"] == row.axis]
    if row.method != "both":
        own = own[own["method"] == row.method]
    column = "error_mm" if row.quantity == "absolute error" else "uncertainty_mm"
    values = own[column].abs()
    low, high = float(values.min()), float(values.max())
    # where the article gives a least value only, the least of ours is compared
    verdict = compare(low, high if row.high is not None else low, row.low, row.high)
    return SummaryRow(
        experiment=EXPERIMENT, quantity=row.quantity, method=row.method, axis=row.axis, unit="mm",
        article_low=row.low, article_high=row.high, ours_low=low, ours_high=high, verdict=verdict,
    )  # fmt: skip


def _row(
    quantity: str, method: str, axis: str, unit: str, low: float, high: float, verdict: str,
    article: tuple[float | None, float | None] = (None, None),
) -> SummaryRow:  # fmt: skip
    return SummaryRow(
        experiment=EXPERIMENT, quantity=quantity, method=method, axis=axis, unit=unit,
        article_low=article[0], article_high=article[1], ours_low=low, ours_high=high,
        verdict=verdict,
    )  # fmt: skip


def _case_errors(quantity: str, errors: Errors) -> list[SummaryRow]:
    rows = []
    for axis in "xy":
        article = reported("absolute error", axis)
        low, high = errors.low_mm[axis], errors.high_mm[axis]
        verdict = compare(low, high, article.low, article.high)
        rows.append(
            _row(quantity, "both", axis, "mm", low, high, verdict, (article.low, article.high))
        )
    rows.append(
        _row(quantity, "both", "z", "mm", errors.low_mm["z"], errors.high_mm["z"], _UNREPORTED)
    )
    return rows


def _depth_share(quantity: str, errors: Errors) -> SummaryRow:
    low, _, high = errors.z_percent
    verdict = compare(high, high, ARTICLE_Z_PERCENT, None)
    return _row(quantity, "both", "z", "%", low, high, verdict, (None, ARTICLE_Z_PERCENT))


def _targets(title: str, errors: Errors, factor: float) -> list[SummaryRow]:
    """Our own targets: their limits stand where the article's figures would."""
    rows = []
    for what, axis, unit, value, limit in (
        ("greatest error over depth", "z", "%", errors.z_percent[2], Z_WORST_PERCENT),
        ("median error over depth", "z", "%", errors.z_percent[1], Z_MEDIAN_PERCENT),
        ("greatest error", "x", "mm", errors.high_mm["x"], XY_WORST_MM),
        ("greatest error", "y", "mm", errors.high_mm["y"], XY_WORST_MM),
    ):
        verdict = "target met" if value <= factor * limit else "target missed"
        quantity = f"{what}, {title}, target {factor * limit:g} {unit}"
        rows.append(_row(quantity, "both", axis, unit, value, value, verdict))
    return rows


def conclude(table: pd.DataFrame, config: SimulatedStaticConfig) -> str:
    """What the numbers say, in one paragraph."""
    found = find(table)
    exact, own = found.errors["exact"], found.errors[ARTICLE_CASE]
    n = int(table[table["images"] == "rendered"]["n"].max())
    return " ".join((
        f"With an exact model the mean of {n} fixes is off by at most {exact.high_mm['x']:.3f} mm "
        f"in x, {exact.high_mm['y']:.3f} mm in y and {exact.z_percent[2]:.3f} % of depth in z "
        f"(median {exact.z_percent[1]:.3f} %), which {_met(exact, 1.0)} our targets of "
        f"{XY_WORST_MM:g} mm, {Z_WORST_PERCENT:g} % and {Z_MEDIAN_PERCENT:g} %; a dithered "
        f"fixation is off by at most {found.dithered.high_mm['x']:.3f} mm, "
        f"{found.dithered.high_mm['y']:.3f} mm and {found.dithered.z_percent[2]:.3f} % (median "
        f"{found.dithered.z_percent[1]:.3f} %), which {_met(found.dithered, 0.5)} half of them"
        f"{_dithering(found)}.",
        _principal(own),
        _drawn_sentence(found),
        f"The two methods' means differ by at most {found.difference_mm:.3f} mm in any case: on a "
        "settled target they are one computation, whatever the model's errors. Single fixes are "
        f"another matter: those of gaze scatter {found.scatter_ratio:.2f} times as much in z as "
        "those of ITPC, because the loop lets little of the detector's noise through to the eyes.",
        _noise(found),
        *_missing(),
    ))  # fmt: skip


def _met(errors: Errors, factor: float) -> str:
    return "meets" if errors.meets(factor) else "misses"


def _dithering(found: Findings) -> str:
    still, dithered = found.errors["exact"].z_percent[2], found.dithered.z_percent[2]
    if dithered < 0.8 * still:
        return f" and divides the worst error in z by {still / dithered:.1f}"
    return (
        f", but the worst error in z is {dithered / still:.1f} times that of the still one: the "
        f"detector's bias at the principal point, at most {found.bias_px:.4f} px here, is too "
        "small for dithering to help"
    )


def _principal(own: Errors) -> str:
    x, y = reported("absolute error", "x"), reported("absolute error", "y")
    matched = [
        axis
        for axis, row in (("x", x), ("y", y))
        if _alike(own.low_mm[axis], row.low) and _alike(own.high_mm[axis], row.high or row.low)
    ]
    what = {
        0: "neither the article's x nor its y",
        1: f"the article's range in {matched[0] if matched else ''}, and not in the other axis",
        2: "the article's range in both",
    }[len(matched)]
    return (
        "Table 2's principal point, one pixel from the images' centre, makes errors of "
        f"{own.low_mm['x']:.2f} to {own.high_mm['x']:.2f} mm in x and {own.low_mm['y']:.2f} to "
        f"{own.high_mm['y']:.2f} mm in y where the article has {x.low:g} to {x.high:g} and "
        f"{y.low:g} to {y.high:g}; within 20 % at both ends, that explains {what}. Its error in z, "
        f"at most {own.z_percent[2]:.3f} % of depth, leaves most of the article's "
        f"{ARTICLE_Z_PERCENT:g} % to other causes."
        if own.z_percent[2] < 0.5 * ARTICLE_Z_PERCENT
        else "Table 2's principal point, one pixel from the images' centre, makes errors of "
        f"{own.low_mm['x']:.2f} to {own.high_mm['x']:.2f} mm in x, {own.low_mm['y']:.2f} to "
        f"{own.high_mm['y']:.2f} mm in y and at most {own.z_percent[2]:.3f} % of depth in z."
    )


def _alike(ours: float, article: float) -> bool:
    return 0.8 * article <= ours <= 1.2 * article


def _drawn_sentence(found: Findings) -> str:
    drawn = found.errors["drawn"]
    article = ARTICLE_Z_PERCENT / 100.0 * 2500.0 / (reported("absolute error", "x").high or 1.0)
    return (
        "Errors drawn independently for the two eyes look different: the head with images is off "
        f"by up to {drawn.high_mm['x']:.2f} mm in x and {drawn.z_percent[2]:.2f} % of depth in z, "
        f"and at the farthest point the error in z is {found.drawn_ratio:.0f} times that in x in "
        f"the median of the drawn heads, against at most {article:.1f} in the article; "
        f"{100.0 * found.drawn_both:.0f} % of these heads have both an error in x like the "
        "article's and one in z within its "
        f"{ARTICLE_Z_PERCENT:g} %, so "
        + (
            "its errors are more likely common to both eyes."
            if found.drawn_both < 0.05
            else "its errors may well be of that kind."
        )
    )


def _noise(found: Findings) -> str:
    low, high = found.sigma_px
    values = [value for pair in found.implied_px.values() for value in pair]
    inside = sum(ARTICLE_DETECTION_PX[0] <= value <= ARTICLE_DETECTION_PX[1] for value in values)
    each = "; ".join(f"{axis} {a:.3f} and {b:.3f}" for axis, (a, b) in found.implied_px.items())
    return (
        f"Our detections have standard deviations of {low:.3f} to {high:.3f} px. The extremes of "
        f"the article's Fig. 7 imply (px at 0.5 and 2.5 m) {each}: {inside} of {len(values)} lie "
        f"in its {ARTICLE_DETECTION_PX[0]:g} to {ARTICLE_DETECTION_PX[1]:g} px"
        + (", so its uncertainties are consistent with its noise."
           if inside == len(values)
           else ", so not all of its uncertainties follow from its noise.")
    )  # fmt: skip


def _missing() -> list[str]:
    if "calibrated" in CASES:
        return []
    return ["The fourth case, a calibrated model, waits for calibration."]
