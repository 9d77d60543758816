"""The physical twin on static targets: Table 5, Figures 10 and 11."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from vergence.envs.streams import IntArray
from vergence.errors import ConfigurationError
from vergence.eval.article import closed_loop, twin
from vergence.eval.article.closed_loop import MM, ClosedLoop, GazeRecord, hold_gaze
from vergence.eval.article.criterion import BY_CONSTRUCTION
from vergence.eval.article.error_budget import (
    ALL,
    ENCODERS,
    SOURCES,
    BudgetCase,
    budget_rows,
    crossover_px,
    detector_rows,
    off_axis_rows,
)
from vergence.eval.article.experiment import Experiment, SummaryRow, rows_where
from vergence.eval.article.reported import (
    ARTICLE_LARGEST_PERCENT,
    ReportedResult,
    reported_result,
    reported_results,
)
from vergence.eval.article.twin import AXES, METHODS
from vergence.models.head import HeadModel
from vergence.models.parts import EYES, FloatArray
from vergence.reporting import style
from vergence.reporting.jobs import Job, Mapper
from vergence.reporting.text import Numbers, read_template
from vergence.triangulation import triangulate_gaze


@dataclass(frozen=True, kw_only=True)
class PhysicalStaticConfig(twin.TwinConfig):
    """Configuration of static targets on the physical twin."""

    imaged_every: int = 1
    """Step through Table 5's points for the head with images; the population uses all points."""
    samples: int = 1200
    """Fixes recorded at each point; the article's n."""
    settle_s: float = 2.0
    """Settling time before the first fix, s."""
    offsets_px: tuple[float, ...] = (0.0, 25.0, 50.0, 100.0, 150.0, 200.0, 250.0, 300.0)
    """Distances from the principal points at which ITPC is evaluated, rising, px."""
    worse_margin: float = 0.05
    """Excess of ITPC's error over that of gaze from which it counts as worse, as a fraction."""

    def __post_init__(self) -> None:
        if max(self.offsets_px) <= 0.0:
            raise ConfigurationError(
                f"offsets_px: expected one beyond the axis at least, got {self.offsets_px}"
            )


def run(config: PhysicalStaticConfig, seed: int, mapper: Mapper) -> pd.DataFrame:
    """Run the population, the head with images, the error budget and ITPC off the axis.

    The table's `case` is `twin` (one row: error scale, index of the head with images, effect of one
    encoder step), `detector` (a row per point), `fixation` (a row per head, point and method),
    `budget` (a row per source and point) or `off axis` (a row per source and offset).
    """
    drawn = twin.draw_population(config, seed, mapper)
    nominal, points = drawn.nominal, drawn.points
    case = BudgetCase(nominal, config.errors.scaled(drawn.scale), config.heads, points, seed)
    excess = ARTICLE_LARGEST_PERCENT["itpc"] - ARTICLE_LARGEST_PERCENT["gaze"]
    jobs: list[Job] = []
    for source in (ALL, *SOURCES):
        jobs.append(partial(budget_rows, case, source))
        jobs.append(partial(off_axis_rows, case, source, config.offsets_px, excess))
    frames: list[pd.DataFrame] = [
        *mapper(jobs),
        detector_rows(nominal, points, drawn.detector.bias_px, "detector bias"),
        detector_rows(nominal, points, drawn.detector.sigma_px, "one image's noise"),
        drawn.detector.table(points),
        drawn.table_row().assign(**_encoder_step(drawn)),
    ]
    jobs = []
    for i, point in enumerate(points):
        loop = drawn.hold_static_target(
            i + 1, point, samples=config.samples, settle_s=config.settle_s, seed=seed
        )
        jobs.append(partial(_population, loop, i + 1))
        if i % config.imaged_every == 0:
            jobs.append(partial(_imaged, loop, drawn.imaged_head, i + 1))
    frames += mapper(jobs)
    return pd.concat(frames, ignore_index=True)


def _encoder_step(drawn: twin.TwinPopulation) -> dict[str, float]:
    """Depth error of the farthest point from one step of the left pan encoder."""
    nominal, far = drawn.nominal, drawn.points[np.argmax(drawn.points[:, 2])]
    q = nominal.fixate(far, nominal.rest()[:3])
    step = np.zeros(7)
    step[EYES.start + 1] = nominal.sensor.encoder_resolution_rad
    moved = abs(float((triangulate_gaze(nominal, q + step).point - far)[2]))
    percent = 100.0 * moved / float(far[2])
    return {"encoder_step_mm": MM * moved, "encoder_step_percent": percent}


def _population(loop: ClosedLoop, number: int) -> pd.DataFrame:
    """Run all heads at one point, without images."""
    record = hold_gaze(loop)
    which = np.arange(loop.num or 1)
    return pd.concat([_rows("population", method, record, which, number) for method in METHODS])


def _imaged(loop: ClosedLoop, which: int, number: int) -> pd.DataFrame:
    """Run one head at one point on rendered images, with the article's propagated uncertainties."""
    nominal = loop.head
    assert loop.true_head is not None  # a population's loop
    head: HeadModel = loop.true_head[which]
    record = hold_gaze(loop.of_heads(head[None], loop.trial, images=True))
    sigma_px = closed_loop.detection_sigma(record.pixels)[0]
    q = record.positions.mean(axis=0)[0]
    pixels = np.nanmean(record.pixels, axis=0)[0]
    uncertainty = {
        "gaze": closed_loop.gaze_uncertainty_mm(nominal, q, sigma_px),
        "itpc": closed_loop.itpc_uncertainty_mm(nominal, q, pixels, sigma_px),
    }
    return pd.concat([
        _rows("imaged", method, record, np.array([which]), number).assign(
            **twin.axis_columns(uncertainty=uncertainty[method]),
            sigma_rms_px=float(np.sqrt(np.mean(sigma_px**2))),
            sigma_least_px=float(sigma_px.min()), sigma_greatest_px=float(sigma_px.max()),
        )
        for method in METHODS
    ])  # fmt: skip


def _rows(
    group: str, method: str, record: GazeRecord, heads: IntArray, number: int
) -> pd.DataFrame:
    """One row per head: error of the mean fix and scatter of the fixes."""
    error = record.gaze_error_mm if method == "gaze" else record.itpc_error_mm
    by_axis = np.moveaxis(error, -1, 0)
    pixel_error = np.linalg.norm(np.nanmean(record.pixel_error, axis=0), axis=-1)
    return pd.DataFrame({
        "case": "fixation", "group": group, "head": heads, "point": number, "method": method,
        "truth_z_mm": MM * record.target[0, :, 2], "pixel_error_px": pixel_error.max(-1),
        "seen_share": np.isfinite(record.pixels).all(axis=(-2, -1)).mean(axis=0),
        **twin.axis_columns(
            error=[np.nanmean(own, axis=0) for own in by_axis],
            scatter=[np.nanstd(own, axis=0, ddof=1) for own in by_axis],
        ),
    })  # fmt: skip


NAME: Final = "physical static"
_row = partial(SummaryRow.of, NAME)
ARTICLE_SMALLEST_PERCENT: Final = {"gaze": 0.23, "itpc": 0.38}
"""The article's smallest depth errors, percent of depth."""
STILL_MM: Final = 1e-3
"""Scatter of fixes below which no encoder reading changed, mm (numerical)."""
_DIGITS: Final = 6
"""Decimals kept of errors in percent, to drop rounding errors (numerical)."""


def article_results(quantity: str) -> list[ReportedResult]:
    """The article's rows of this experiment."""
    return [r for r in reported_results() if (r.experiment, r.quantity) == (NAME, quantity)]


def population_ranks(table: pd.DataFrame, row: ReportedResult) -> tuple[twin.RankInPopulation, ...]:
    """Ranks of the article's least and greatest error in `row` among the heads'."""
    return twin.rank_ends(
        row.span, twin.absolute_errors_mm(twin.fixation_rows(table), row.method, row.axis)
    )


def summarise(table: pd.DataFrame, config: PhysicalStaticConfig) -> list[SummaryRow]:
    """Rows of the summary: the article's beside the median heads', then population and sources."""
    return [
        *_reported_rows(table), *_population_rows(table), *_imaged_rows(table),
        *_off_axis_rows(table, config), *_budget_rows(table),
    ]  # fmt: skip


def _reported_rows(table: pd.DataFrame) -> Iterator[SummaryRow]:
    for r in article_results("absolute error"):
        ours = tuple(rank.median for rank in population_ranks(table, r))
        # the error scale was set by the largest depth error by gaze
        chosen = BY_CONSTRUCTION if (r.method, r.axis) == ("gaze", "z") else None
        yield _row(r.quantity, r.method, r.axis, r.span, ours, chosen)
    for r in article_results("uncertainty"):
        ours = _range(twin.fixation_rows(table, "imaged")[f"uncertainty_{r.axis}_mm"])
        yield _row(r.quantity, r.method, r.axis, r.span, ours)


def _population_rows(table: pd.DataFrame) -> Iterator[SummaryRow]:
    """Statistics of the population, 10th to 90th percentile of the heads."""
    population = twin.fixation_rows(table)
    yield _row("scale of all spreads", "both", "all", None, float(_twin(table)["scale"]), unit="1")
    for method in METHODS:
        relative = twin.depth_errors_percent(population, method)
        largest = twin.rank_in_population(ARTICLE_LARGEST_PERCENT[method], relative.max(axis=1))
        smallest = twin.rank_in_population(ARTICLE_SMALLEST_PERCENT[method], relative.min(axis=1))
        chosen = BY_CONSTRUCTION if method == "gaze" else largest.verdict
        for which, rank, said in (
            ("largest", largest, chosen),
            ("smallest", smallest, smallest.verdict),
        ):
            quantity = f"{which} depth error, middle 80 % of the heads"
            yield _row(quantity, method, "z", rank.article, (rank.low, rank.high), said, "%")
        for axis in AXES:
            means = twin.absolute_errors_mm(population, method, axis).mean(axis=1)
            low, high = np.percentile(means, [10.0, 90.0])
            yield _row("mean absolute error", method, axis, None, (low, high))


def _imaged_rows(table: pd.DataFrame) -> Iterator[SummaryRow]:
    imaged, apart = twin.fixation_rows(table, "imaged"), _apart(table)
    for method in METHODS:
        for axis in AXES:
            ours = _range(twin.absolute_errors_mm(imaged, method, axis))
            yield _row("absolute error, head with images", method, axis, None, ours)
    yield _row("gaze and ITPC apart in depth at settled fixations", "both", "z",
               _article_apart_mm(), (float(np.median(apart)), float(apart.max())))  # fmt: skip


def _off_axis_rows(table: pd.DataFrame, config: PhysicalStaticConfig) -> Iterator[SummaryRow]:
    whole = _off_axis(table, ALL)
    yield _row("largest depth error off the axis, median head", "itpc", "z",
               ARTICLE_LARGEST_PERCENT["itpc"], _range(whole["itpc_largest_percent"]),
               unit="%")  # fmt: skip
    yield _row("offset from which ITPC is worse than gaze, all errors", "both", "z",
               None, crossover_px(whole, config.worse_margin), unit="px")  # fmt: skip
    for source in (ALL, *SOURCES):
        rows = _off_axis(table, source)
        last = rows.iloc[-1]
        gaze, itpc = last["gaze_rms_percent"], last["itpc_rms_percent"]
        verdict = "ITPC better" if itpc < (1.0 - config.worse_margin) * gaze else "alike"
        if np.isfinite(crossover_px(rows, config.worse_margin)):
            verdict = "ITPC worse"
        quantity = (
            f"rms depth error of ITPC {last['offset_px']:g} px off the axis less that of gaze, "
            f"{_title(source)}"
        )
        yield _row(quantity, "both", "z", None, round(itpc - gaze, _DIGITS), verdict, "%")


def _budget_rows(table: pd.DataFrame) -> Iterator[SummaryRow]:
    """Depth errors from each source alone, over Table 5's points."""
    for source, rows in rows_where(table, case="budget").groupby("source", sort=False):
        ours = _range(rows["rms_depth_error_percent"].round(_DIGITS))
        quantity = f"rms depth error of a fixation, {_title(str(source))}"
        yield _row(quantity, "both", "z", None, ours, unit="%")


def _title(source: str, short: bool = False) -> str:
    return {**SOURCES, ALL: ("all errors", "all errors")}.get(source, (source, source))[short]


def _range(values: FloatArray | pd.Series) -> tuple[float, float]:
    return float(values.min()), float(values.max())


def _twin(table: pd.DataFrame) -> pd.Series:
    return rows_where(table, case="twin").iloc[0]


def _off_axis(table: pd.DataFrame, source: str) -> pd.DataFrame:
    """Rows of one source, from the axis outwards."""
    rows = rows_where(table, case="off axis", source=source)
    return rows.sort_values("offset_px")


def _apart(table: pd.DataFrame) -> FloatArray:
    """(heads * points,) absolute depth difference of gaze and ITPC at settled fixations, mm."""
    rows = twin.fixation_rows(table).pivot(
        index=["head", "point"], columns="method", values="error_z_mm"
    )
    return np.asarray((rows["gaze"] - rows["itpc"]).abs().to_numpy(), dtype=np.float64)


def _article_apart_mm() -> float:
    """Difference of the article's largest depth errors, ITPC minus gaze, mm."""
    gaze, itpc = (reported_result(NAME, "absolute error", m, "z").span[1] for m in METHODS)
    return itpc - gaze


def numbers(table: pd.DataFrame, config: PhysicalStaticConfig) -> Numbers:
    """The numbers of the text."""
    largest = twin.depth_errors_percent(twin.fixation_rows(table), "gaze").max(axis=1)
    inside = [
        twin.count_inside(population_ranks(table, r)) for r in article_results("absolute error")
    ]
    apart, row = _apart(table), _twin(table)
    return {
        "points_count": float(twin.fixation_rows(table)["point"].nunique()),
        "scale_ratio": float(row["scale"]),
        "largest_median_percent": float(np.median(largest)),
        "largest_high_percent": float(np.percentile(largest, 90.0)),
        "inside_count": sum(inside),
        "reported_count": 2 * len(inside),
        "apart_median_mm": float(np.median(apart)),
        "apart_most_mm": float(apart.max()),
        "article_apart_mm": _article_apart_mm(),
        "encoder_step_mm": float(row["encoder_step_mm"]),
        "encoder_step_percent": float(row["encoder_step_percent"]),
        **_off_axis_numbers(table, config),
        **_budget_numbers(table),
        **_imaged_numbers(table),
    }


def _off_axis_numbers(table: pd.DataFrame, config: PhysicalStaticConfig) -> Numbers:
    """Numbers on ITPC off the axis, at the largest and at the smallest non-zero offset."""
    whole, encoders = _off_axis(table, ALL), _off_axis(table, ENCODERS)
    beside = whole["offset_px"].to_numpy() > 0.0
    last, first = whole.iloc[-1], whole[beside].iloc[0]
    return {
        "margin_percent": 100.0 * config.worse_margin,
        "crossover_px": crossover_px(whole, config.worse_margin),
        "outermost_px": last["offset_px"],
        "outermost_itpc_percent": last["itpc_rms_percent"],
        "outermost_gaze_percent": last["gaze_rms_percent"],
        "outermost_worse_percent": 100.0 * last["worse_share"],
        "outermost_possible_percent": 100.0 * last["possible_share"],
        "innermost_px": first["offset_px"],
        "innermost_apart_percent": first["added_rms_percent"],
        "innermost_encoders_percent": encoders[beside].iloc[0]["added_rms_percent"],
        "itpc_largest_percent": float(whole["itpc_largest_percent"].max()),
        "excess_most_percent": 100.0 * float(whole["excess_share"].max()),
    }


def _budget_numbers(table: pd.DataFrame) -> Numbers:
    """Depth errors from each source alone at the nearest and at the farthest point."""
    rows = rows_where(table, case="budget")
    wide = rows.pivot(index="truth_z_mm", columns="source", values="rms_depth_error_percent")
    return {"near_m": wide.index[0] / 1000.0, "far_m": wide.index[-1] / 1000.0} | {
        f"{where}_{source.replace(' ', '_')}_percent": float(wide[source].iloc[end])
        for where, end in (("near", 0), ("far", -1))
        for source in (ALL, ENCODERS, "head_eye_rad", "principal_px", "joint_offset_rad")
    }


def _imaged_numbers(table: pd.DataFrame) -> Numbers:
    """Numbers on the head with images: errors, detection noise and propagated uncertainty."""
    imaged, population = twin.fixation_rows(table, "imaged"), twin.fixation_rows(table)
    far = imaged.sort_values("uncertainty_z_mm").iloc[-1]
    article = reported_result(NAME, "uncertainty", "both", "z").span[1]
    ratio = float(far["uncertainty_z_mm"]) / article
    still = {
        name: rows_where(rows, method="gaze")["scatter_z_mm"] <= STILL_MM
        for name, rows in (("imaged", imaged), ("population", population))
    }
    uncertainty = {axis: _range(imaged[f"uncertainty_{axis}_mm"]) for axis in AXES}
    return {
        "imaged_head": float(imaged["head"].iloc[0]),
        "imaged_largest_percent": float(twin.depth_errors_percent(imaged, "gaze").max()),
        "sigma_least_px": float(imaged["sigma_least_px"].min()),
        "sigma_greatest_px": float(imaged["sigma_greatest_px"].max()),
        **{f"uncertainty_{axis}_least_mm": low for axis, (low, _) in uncertainty.items()},
        **{f"uncertainty_{axis}_greatest_mm": high for axis, (_, high) in uncertainty.items()},
        "uncertainty_ratio": ratio,
        "article_sigma_px": float(far["sigma_rms_px"]) / ratio,
        "still_count": float(still["imaged"].sum()),
        "imaged_count": float(len(still["imaged"])),
        "still_percent": 100.0 * float(still["population"].mean()),
    }


_MARKS: Final = (
    (style.BLUE, "o", "-"), (style.ORANGE, "s", "--"), (style.GREEN, "^", "-"),
    (style.PURPLE, "D", "--"), (style.BLACK, "v", "-"), (style.GREY, "P", ":"),
    (style.BLUE, "x", ":"), (style.ORANGE, "*", "-"), (style.GREEN, "<", ":"),
    (style.PURPLE, ">", "-"), (style.GREY, "h", "--"), (style.BLACK, "+", "--"),
)  # fmt: skip
_NEGLIGIBLE_PERCENT: Final = 0.002
"""Depth error below which a source is not drawn, percent of depth (chosen: readability)."""
DASHES: Final = {"gaze": "--", "itpc": ":"}
"""Line styles of the article's values by method."""


def draw(table: pd.DataFrame, config: PhysicalStaticConfig) -> dict[str, Figure]:
    """All figures by name."""
    del config
    return {
        "fig10-absolute-errors-physical": _errors(table),
        "fig10-population": _draw_population(table),
        "fig11-uncertainties-physical": _uncertainties(table),
        "physical-error-budget": _budget(table),
        "physical-itpc-off-axis": _draw_off_axis(table),
    }


def _errors(table: pd.DataFrame) -> Figure:
    figure = style.new_figure(9.6, 4.0)
    population, imaged = twin.fixation_rows(table), twin.fixation_rows(table, "imaged")
    depth, looked = (np.sort(rows["truth_z_mm"].unique()) / 1000.0 for rows in (population, imaged))
    for axis, panel in zip(AXES, figure.subplots(1, 3), strict=True):
        errors = twin.absolute_errors_mm(population, "gaze", axis)
        low, median, high = np.percentile(errors, [10.0, 50.0, 90.0], axis=0)
        panel.fill_between(depth, low, high, color=style.BLUE, alpha=0.2, linewidth=0.0,
                           label="heads, 10-90 %")  # fmt: skip
        panel.plot(depth, median, color=style.BLUE, linewidth=1.2, label="median head")
        for method in METHODS:
            label, dash = (
                f"{twin.METHOD_LABELS[method]}, images",
                "-" if method == "gaze" else "none",
            )
            look = twin.method_look(method, 9, label=label, linewidth=1.3, linestyle=dash)
            panel.plot(looked, twin.absolute_errors_mm(imaged, method, axis)[0], **look)
        for r in article_results("absolute error"):
            if r.axis == axis:
                for value in (r.low, r.high):
                    panel.axhline(value, **{**style.ARTICLE_STYLE, "linestyle": DASHES[r.method]})
        for method, dash in DASHES.items():
            look = {**style.ARTICLE_STYLE, "linestyle": dash}
            panel.plot([], [], label=f"article, {twin.METHOD_LABELS[method]}", **look)
        panel.set(xlabel="depth z [m]", ylabel=f"|error in {axis}| [mm]", ylim=(0.0, None))
    style.legend_below(figure, 3)
    return figure


def _draw_population(table: pd.DataFrame) -> Figure:
    figure = style.new_figure(9.0, 4.6)
    population = twin.fixation_rows(table)
    left, right = figure.subplots(1, 2)
    largest = np.sort(twin.depth_errors_percent(population, "gaze").max(axis=1))
    share = 100.0 * (np.arange(len(largest)) + 0.5) / len(largest)
    left.plot(largest, share, color=style.BLUE, drawstyle="steps-mid", label="gaze, settled")
    for method, percent in ARTICLE_LARGEST_PERCENT.items():
        left.axvline(percent, color=style.BLACK, linestyle=DASHES[method], linewidth=1.3,
                     label=f"article, {twin.METHOD_LABELS[method]}: {percent} %")  # fmt: skip
    left.set(
        xlabel="largest depth error of a head [% of depth]",
        ylabel="heads below [%]",
        xlim=(0.0, None),
    )
    style.legend_below(left, 1)
    names, places = [], []
    for r in article_results("absolute error"):
        for which, placed in zip(("least", "most"), population_ranks(table, r), strict=True):
            names.append(f"{r.axis} {which}, {twin.METHOD_LABELS[r.method]}")
            places.append(placed.percentile)
    row = np.arange(len(names))[::-1]
    right.axvspan(10.0, 90.0, **style.ARTICLE_BAND)
    right.plot(places, row, linestyle="none", marker="D", color=style.BLACK, markersize=7)
    right.set_yticks(row, names)
    right.set_xlim(0.0, 100.0)
    right.set_xlabel("article's head among ours [percentile]")
    right.set_title("shaded: middle 80 % of the heads", fontsize=11)
    return figure


def _uncertainties(table: pd.DataFrame) -> Figure:
    figure = style.new_figure(9.6, 3.9)
    imaged = twin.fixation_rows(table, "imaged")
    for r, panel in zip(article_results("uncertainty"), figure.subplots(1, 3), strict=True):
        panel.axhspan(r.low, r.high, **style.ARTICLE_BAND)
        for method in METHODS:
            rows = rows_where(imaged, method=method).sort_values("truth_z_mm")
            look = twin.method_look(method, 9)
            panel.plot(rows["truth_z_mm"] / 1000.0, rows[f"uncertainty_{r.axis}_mm"], **look)
        rows = rows_where(imaged, method="gaze").sort_values("truth_z_mm")
        moved = rows[rows[f"scatter_{r.axis}_mm"] > STILL_MM]
        panel.plot(moved["truth_z_mm"] / 1000.0, moved[f"scatter_{r.axis}_mm"], color=style.GREEN,
                   marker="^", linestyle="none",
                   label="gaze, observed scatter where an encoder stepped")  # fmt: skip
        panel.fill_between([], [], label="article's range", **style.ARTICLE_BAND)
        style.log_axis(panel)
        panel.set(xlabel="depth z [m]", ylabel=f"uncertainty in {r.axis} [mm]")
    style.legend_below(figure, 2)
    return figure


def _budget(table: pd.DataFrame) -> Figure:
    figure = style.new_figure(8.0, 5.2)
    panel = figure.subplots()
    budget = rows_where(table, case="budget")
    whole = rows_where(budget, source=ALL).sort_values("truth_z_mm")
    panel.plot(whole["truth_z_mm"] / 1000.0, whole["rms_depth_error_percent"], color=style.BLACK,
               linewidth=3.0, label="all, encoders too")  # fmt: skip
    order = (
        budget[(budget["source"] != ALL)]
        .groupby("source")["rms_depth_error_percent"].max().sort_values(ascending=False)
    )  # fmt: skip
    for source, (colour, marker, dash) in zip(
        order[order > _NEGLIGIBLE_PERCENT].index, _MARKS, strict=False
    ):
        rows = rows_where(budget, source=source).sort_values("truth_z_mm")
        panel.plot(rows["truth_z_mm"] / 1000.0, rows["rms_depth_error_percent"], color=colour,
                   marker=marker, linestyle=dash, linewidth=1.2, markevery=2,
                   label=_title(source, short=True))  # fmt: skip
    panel.axhline(
        ARTICLE_LARGEST_PERCENT["gaze"], label="article's largest, gaze", **style.ARTICLE_STYLE
    )
    zero = [_title(s) for s in order[order <= _NEGLIGIBLE_PERCENT].index]
    if zero:
        panel.set_title(f"nothing by: {', '.join(zero)}", fontsize=11)
    style.log_axis(panel)
    panel.set(xlabel="depth z [m]", ylabel="rms depth error of a fixation [% of depth]")
    figure.legend(*panel.get_legend_handles_labels(), loc="outside right center")
    return figure


def _draw_off_axis(table: pd.DataFrame) -> Figure:
    figure = style.new_figure(9.6, 5.0)
    left, right = figure.subplots(1, 2)
    rows = rows_where(table, case="off axis")
    whole = rows_where(rows, source=ALL).sort_values("offset_px")
    look = {m: {**style.METHOD_STYLE[m]} for m in METHODS}
    look["gaze"]["label"], look["itpc"]["label"] = "gaze, settled: rms", "ITPC: rms"
    for method in METHODS:
        left.plot(whole["offset_px"], whole[f"{method}_rms_percent"], **look[method])
    left.plot(whole["offset_px"], whole["added_rms_percent"], color=style.GREEN, marker="^",
              linestyle="-.", label="difference: rms")  # fmt: skip
    left.plot(whole["offset_px"], whole["itpc_largest_percent"], color=style.PURPLE, marker="D",
              linestyle="-", label="ITPC: median head's largest")  # fmt: skip
    left.axhline(
        ARTICLE_LARGEST_PERCENT["itpc"], label="article's largest, ITPC", **style.ARTICLE_STYLE
    )
    left.set_ylim(bottom=0.0)
    left.set(title="all errors", ylabel="depth error [% of depth]")
    style.legend_below(left, 1)
    for source, (colour, marker, dash) in zip(SOURCES, _MARKS, strict=False):
        own = rows_where(rows, source=source).sort_values("offset_px")
        change = own["itpc_rms_percent"] - own["gaze_rms_percent"]
        right.plot(own["offset_px"], change, color=colour, marker=marker, linestyle=dash,
                   linewidth=1.3, label=_title(source, short=True))  # fmt: skip
    right.axhline(0.0, color=style.BLACK, linewidth=1.0)
    right.set(title="one source alone", ylabel="rms of ITPC less that of gaze [points]")
    style.legend_below(right, 2, columnspacing=1.0)
    for panel in (left, right):
        panel.set_xlabel("target off the axis [px]")
    return figure


EXPERIMENT: Final = Experiment(
    name="physical-static", title="Physical twin, static targets",
    article="Section 5.1.2, Table 5, Figures 10 and 11",
    text=read_template(__package__, "sections/physical_static.jinja"), config=PhysicalStaticConfig,
    quick={
        "heads": 40, "imaged_every": 5, "samples": 60, "noise_poses": 2, "noise_frames": 10,
        "offsets_px": (0.0, 100.0, 200.0, 300.0),
    },
    run=run, summarise=summarise, numbers=numbers, draw=draw,
)  # fmt: skip
