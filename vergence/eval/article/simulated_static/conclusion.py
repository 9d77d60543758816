"""What the static targets on the simulated rig say, in one paragraph made of the numbers."""

from typing import Final

import numpy as np
import pandas as pd

from vergence.eval.article.common.simulated_cases import CASES
from vergence.eval.article.simulated_static.findings import (
    ARTICLE_CASE,
    ARTICLE_DETECTION_PX,
    ARTICLE_Z_PERCENT,
    XY_WORST_MM,
    Z_MEDIAN_PERCENT,
    Z_WORST_PERCENT,
    Errors,
    Findings,
    find,
    reported,
)
from vergence.eval.article.simulated_static.trials import SimulatedStaticConfig
from vergence.models.files.head_file import load_head

_FEW_STANDARD_ERRORS: Final = 5.0


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
        f"The two methods' means differ by at most {found.difference_mm:.3f} mm in any case, "
        f"{found.difference_se:.1f} standard errors of the mean"
        + (
            ": on a settled target they are one computation, whatever the model's errors."
            if found.difference_se < _FEW_STANDARD_ERRORS
            else ", more than averaging explains."
        ),
        f"Single fixes of gaze scatter {found.scatter_ratio:.2f} times as much in z as those of "
        "ITPC"
        + (
            ", because the loop lets little of the detector's noise through to the eyes."
            if found.scatter_ratio < 0.5
            else "."
        ),
        _noise(found),
        *_missing(),
    ))  # fmt: skip


def _met(errors: Errors, factor: float) -> str:
    return "meets" if errors.meets(factor) else "misses"


def _dithering(found: Findings) -> str:
    still, dithered = found.errors["exact"].z_percent[2], found.dithered.z_percent[2]
    principal = load_head("simulated").cameras.principal
    if found.still_se < _FEW_STANDARD_ERRORS:
        return (
            f"; neither is more than noise leaves ({found.still_se:.1f} and "
            f"{found.dithered_se:.1f} standard errors at worst)"
            + (
                ", since the principal points lie half-way between pixels, where the detector's "
                f"bias nearly vanishes by symmetry (at most {found.bias_px:.4f} px, noise "
                "included): what dithering gains elsewhere is in the experiment on uncertainty"
                if np.allclose(principal % 1.0, 0.5)
                else ""
            )
        )
    if dithered < 0.8 * still:
        return f" and divides the worst error in z by {still / dithered:.1f}"
    return f", but the worst error in z is {dithered / still:.1f} times that of the still one"


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
