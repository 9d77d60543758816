"""What the static experiment on the physical twin says: summary rows and conclusion."""

from typing import Any

import numpy as np
import pandas as pd

from vergence.eval.article.experiment import SummaryRow, compare
from vergence.eval.article.physical_static.error_budget import (
    ALL,
    BUDGET_SOURCES,
    ENCODERS,
    crossover_px,
)
from vergence.eval.article.reported import Reported, reported_results
from vergence.eval.article.twin.heads import SOURCE_LABELS
from vergence.eval.article.twin.statistics import (
    AXES,
    METHOD_LABELS,
    METHODS,
    Placement,
    absolute,
    fixations,
    lie,
    listed,
    ordinal,
    place,
    relative_depth,
    verdict,
)

NAME = "physical static"
ARTICLE_LARGEST_PERCENT = {"gaze": 4.97, "itpc": 6.98}
"""The article's largest depth errors, percent of depth."""
ARTICLE_SMALLEST_PERCENT = {"gaze": 0.23, "itpc": 0.38}
"""Its smallest."""
STILL_MM = 1e-3
"""Scatter below which an encoder never stepped."""
_WHY = {
    "x": "errors in x follow those in depth along the line of sight",
    "y": "errors in y follow the common tilt, of which depth errors say nothing",
    "z": "of 21 errors the least is a matter of how the encoders happened to round",
}


def reported(quantity: str) -> list[Reported]:
    """The article's rows of this experiment."""
    return [r for r in reported_results() if (r.experiment, r.quantity) == (NAME, quantity)]


def placements(table: pd.DataFrame, row: Reported) -> list[Placement]:
    """The article's least and greatest error of a method and axis among the heads' own."""
    errors = absolute(fixations(table), row.method, row.axis)
    found = [place(row.low, errors.min(axis=1))]
    if row.high is not None:
        found.append(place(row.high, errors.max(axis=1)))
    return found


def summarise(table: pd.DataFrame, config: Any) -> list[SummaryRow]:
    """Rows of the summary; of a population, the median heads' figures."""
    del config
    rows = []
    for r in reported("absolute error"):
        low, high = placements(table, r)
        rows.append(_row(r, low.median, high.median, verdict((low, high))))
    imaged = fixations(table, "imaged")
    for r in reported("uncertainty"):
        values = imaged[f"uncertainty_{r.axis}_mm"]
        least, most = float(values.min()), float(values.max())
        rows.append(_row(r, least, most, compare(least, most, r.low, r.high)))
    rows += _population_rows(table)
    rows += _imaged_rows(table)
    return rows


def _row(r: Reported, low: float, high: float, said: str) -> SummaryRow:
    return SummaryRow.of(
        r.experiment, r.quantity, r.method, r.axis, (r.low, r.high), (low, high), said
    )


def _own(
    quantity: str,
    method: str,
    axis: str,
    unit: str,
    ours: tuple[float, float],
    article: float | None = None,
    said: str = "not reported",
) -> SummaryRow:
    return SummaryRow.of(NAME, quantity, method, axis, article, ours, said, unit)


def _population_rows(table: pd.DataFrame) -> list[SummaryRow]:
    """Statistics of the population, 10th to 90th percentile of the heads."""
    population = fixations(table)
    scale = float(table.loc[table["case"] == "twin", "scale"].iloc[0])
    rows = [_own("scale of all spreads", "both", "all", "1", (scale, scale))]
    for method in METHODS:
        relative = relative_depth(population, method)
        for quantity, article, values in (
            ("largest depth error", ARTICLE_LARGEST_PERCENT, relative.max(axis=1)),
            ("smallest depth error", ARTICLE_SMALLEST_PERCENT, relative.min(axis=1)),
        ):
            placed = place(article[method], values)
            chosen = method == "gaze" and article is ARTICLE_LARGEST_PERCENT
            said = "by construction" if chosen else verdict([placed])
            rows.append(
                _own(quantity, method, "z", "%", (placed.low, placed.high), placed.article, said)
            )
        for axis in AXES:
            means = absolute(population, method, axis).mean(axis=1)
            low, high = np.percentile(means, [10.0, 90.0])
            rows.append(_own("mean absolute error", method, axis, "mm", (float(low), float(high))))
    return rows


def _imaged_rows(table: pd.DataFrame) -> list[SummaryRow]:
    imaged = fixations(table, "imaged")
    rows = []
    for method in METHODS:
        for axis in AXES:
            errors = absolute(imaged, method, axis)
            ours = float(errors.min()), float(errors.max())
            rows.append(_own("absolute error, head with images", method, axis, "mm", ours))
    return rows


def conclude(table: pd.DataFrame, config: Any) -> str:
    """One paragraph from the numbers."""
    return " ".join(
        [
            _of_population(table),
            _of_methods(table),
            _of_off_axis(table, config),
            _of_budget(table),
            _of_uncertainty(table),
        ]
    )


def _of_population(table: pd.DataFrame) -> str:
    population = fixations(table)
    twin = table[table["case"] == "twin"].iloc[0]
    largest = place(ARTICLE_LARGEST_PERCENT["gaze"], relative_depth(population, "gaze").max(axis=1))
    text = (
        f"With all spreads times {twin['scale']:.2f}, the median head's largest depth error by "
        f"gaze is {largest.median:.2f} % (article {largest.article} %), and nine heads in ten lie "
        f"below {largest.high:.1f} %."
    )
    inside, outside, axes = [], [], []
    for r in reported("absolute error"):
        for which, placed in zip(("smallest", "largest"), placements(table, r), strict=True):
            name = (
                f"the {which} {r.axis} error by {METHOD_LABELS[r.method]} "
                f"({placed.article:g} mm, {ordinal(placed.percentile)}"
            )
            if placed.inside:
                inside.append(f"{name})")
            else:
                outside.append(f"{name}; ours {placed.low:.2f} to {placed.high:.2f} mm)")
                axes.append(r.axis)
    if inside:
        text += (
            f" Of the article's other figures, {listed(inside)} {lie(inside)} within our middle "
            "80 %."
        )
    if outside:
        text += f" Outside it: {listed(outside)}: {listed([_WHY[a] for a in dict.fromkeys(axes)])}."
    return text


def _of_methods(table: pd.DataFrame) -> str:
    population = fixations(table)
    wide = {
        m: population[population["method"] == m].sort_values(["head", "point"]) for m in METHODS
    }
    apart = np.abs(wide["gaze"]["error_z_mm"].to_numpy() - wide["itpc"]["error_z_mm"].to_numpy())
    twin = table[table["case"] == "twin"].iloc[0]
    article = 174.64 - 124.49
    possible = float(apart.max()) >= article
    return (
        "At a settled fixation the two methods are one computation: their mean depths differ by "
        f"{np.median(apart):.3f} mm in the median and {apart.max():.1f} mm at most over all heads "
        f"and points, so the article's 4.97 against 6.98 %, {article:.0f} mm apart, "
        + ("could" if possible else "cannot")
        + " come from settled fixations alone. One step of one pan encoder moves the farthest "
        f"point by {twin['encoder_step_mm']:.0f} mm ({twin['encoder_step_percent']:.1f} %): two "
        "fixations read at different moments may differ by as much."
    )


def _of_off_axis(table: pd.DataFrame, config: Any) -> str:
    rows = table[table["case"] == "off axis"]
    whole = rows[rows["source"] == ALL].sort_values("offset_px")
    last = whole.iloc[-1]
    ratio = last["itpc_rms_percent"] / last["gaze_rms_percent"]
    at_once, later, never, better = [], [], [], []
    for source in BUDGET_SOURCES:
        label = SOURCE_LABELS.get(source, source)
        own = rows[rows["source"] == source].sort_values("offset_px")
        where = crossover_px(own, config.worse_margin)
        end = own.iloc[-1]
        if where == 0.0:
            at_once.append(label)
        elif np.isfinite(where):
            later.append(f"{label} from {where:.0f} px on")
        elif end["itpc_rms_percent"] < (1.0 - config.worse_margin) * end["gaze_rms_percent"]:
            better.append(label)
        else:
            never.append(label)
    overall = crossover_px(whole, config.worse_margin)
    said = (
        f"from {overall:.0f} px off the axis on"
        if np.isfinite(overall)
        else f"nowhere up to {last['offset_px']:.0f} px"
    )
    text = (
        f"When is gaze better than ITPC? With all errors together, ITPC off the axis is worse by "
        f"more than {100 * config.worse_margin:.0f} % {said}: at {last['offset_px']:.0f} px its "
        f"rms depth error is {last['itpc_rms_percent']:.2f} % against "
        f"{last['gaze_rms_percent']:.2f} % by gaze ({ratio:.2f} times), and it is the larger in "
        f"{100 * last['worse_share']:.0f} % of the fixations."
    )
    if at_once:
        text += (
            f" Errors of {listed(at_once)} vanish on the axis, so against these gaze always wins;"
        )
    if later:
        text += f" ITPC loses with errors of {listed(later)};"
    if never:
        text += f" it makes no such difference with {listed(never)};"
    if better:
        text += f" ITPC gains off the axis with errors of {listed(better)};"
    text = text.rstrip(";") + "."
    near = whole[whole["offset_px"] > 0.0].iloc[0]
    rounding = rows[(rows["source"] == ENCODERS) & (rows["offset_px"] == near["offset_px"])]
    text += (
        f" At {last['offset_px']:.0f} px, {100 * last['possible_share']:.0f} % of the directions "
        "are possible. A single fixation differs more than the rms says: already at "
        f"{near['offset_px']:.0f} px the two methods are {near['added_rms_percent']:.2f} % apart, "
        f"rms, and {rounding['added_rms_percent'].iloc[0]:.2f} % with the encoders alone, which "
        "round anew at every posture."
    )
    peak = whole["itpc_largest_percent"].max()
    article = ARTICLE_LARGEST_PERCENT["itpc"]
    reaches = "reaches" if peak >= article else "stays below"
    excess = article - ARTICLE_LARGEST_PERCENT["gaze"]
    return text + (
        f" ITPC's median largest depth error off the axis ({peak:.2f} %) {reaches} the article's "
        f"{article} %, but single heads exceed their own gaze by {excess:.2f} points or more in "
        f"up to {100 * whole['excess_share'].max():.0f} % of heads and directions."
    )


def _of_budget(table: pd.DataFrame) -> str:
    budget = table[(table["case"] == "budget") & (table["source"] != ALL)]
    parts = []
    for depth in (budget["truth_z_mm"].min(), budget["truth_z_mm"].max()):
        here = budget[budget["truth_z_mm"] == depth]
        first = here.sort_values("rms_depth_error_percent", ascending=False).head(3)
        names = [
            f"{SOURCE_LABELS.get(r.source, r.source)} {r.rms_depth_error_percent:.2f} %"
            for r in first.itertuples()
        ]
        parts.append(f"at {depth / 1000:.1f} m {listed(names)}")
    none = [
        SOURCE_LABELS[s]
        for s in SOURCE_LABELS
        if budget.loc[budget["source"] == s, "rms_depth_error_percent"].max() < 1e-3
    ]
    text = f"The depth budget of a fixation, rms, is led by: {'; '.join(parts)}."
    if none:
        text += f" Errors of {listed(none)} cost nothing on the axis."
    encoders = budget[budget["source"] == ENCODERS]["rms_depth_error_percent"]
    return text + f" The encoders alone are {encoders.min():.2f} to {encoders.max():.2f} %."


def _of_uncertainty(table: pd.DataFrame) -> str:
    imaged = fixations(table, "imaged")
    said = []
    for r in reported("uncertainty"):
        values = imaged[f"uncertainty_{r.axis}_mm"]
        said.append(f"{r.axis} {values.min():.3f} to {values.max():.3f} ({r.low:g} to {r.high:g})")
    depth = next(r for r in reported("uncertainty") if r.axis == "z")
    far = imaged.sort_values("uncertainty_z_mm").iloc[-1]
    assert depth.high is not None
    ratio = far["uncertainty_z_mm"] / depth.high
    gaze = imaged[imaged["method"] == "gaze"]["scatter_z_mm"]
    moved = gaze[gaze > STILL_MM]
    largest = relative_depth(imaged, "gaze").max()
    text = (
        f"On drawn images, head {imaged['head'].iloc[0]} of the population, the one most like the "
        f"article's, has a largest depth error of {largest:.2f} %; its detections scatter by "
        f"{imaged['sigma_least_px'].min():.3f} to {imaged['sigma_greatest_px'].max():.3f} px "
        "(article 0.016 to 0.138), which propagates to uncertainties, in mm (article's in "
        f"brackets), of {listed(said)}; in depth the greatest is {ratio:.1f} times the article's, "
        f"which there corresponds to {far['sigma_rms_px'] / ratio:.3f} px of noise."
    )
    if len(moved) < len(gaze):
        whole = fixations(table)
        still = np.mean(whole.loc[whole["method"] == "gaze", "scatter_z_mm"] <= STILL_MM)
        text += (
            f" In {len(gaze) - len(moved)} of its {len(gaze)} fixations gaze did not scatter at all"
            f" (in the population, in {100 * still:.0f} %)"
        )
        text += (
            f"; in the others by {moved.min():.2f} to {moved.max():.2f} mm in depth: the loop lets "
            "little of the noise through, and what is seen of it are steps of the encoders."
            if len(moved)
            else ": the loop lets too little of the noise through to move an encoder by a step."
        )
    return text
