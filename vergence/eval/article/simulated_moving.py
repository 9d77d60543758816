"""A moving target on the simulated rig: Figure 8."""

from dataclasses import dataclass, replace
from functools import partial
from math import hypot, pi
from typing import Final, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from vergence.envs.targets.prescribed import CircleTarget
from vergence.eval.article.closed_loop import MM, ClosedLoop, LinearLoop, hold_gaze, noise_gain
from vergence.eval.article.experiment import Experiment, SummaryRow, job_seed, rows_where
from vergence.eval.article.reported import reported_result, reported_results
from vergence.eval.article.simulated_static import (
    ARTICLE_CASE,
    BOARD,
    CASES,
    DRAWN_ERRORS,
)
from vergence.models.head_file import load_head
from vergence.reporting import style
from vergence.reporting.jobs import Job, Mapper
from vergence.reporting.text import Numbers, read_template

NAME: Final = "simulated-moving"
IMAGES: Final = "images"
WHITE: Final = "white"
NONE: Final = "none"
"""Kinds of detector: the real one on rendered images, one with white noise, one without noise."""


@dataclass(frozen=True, kw_only=True)
class SimulatedMovingConfig:
    """Configuration of the moving target on the simulated rig."""

    samples: int = 3780
    """Samples along the circle; the article's n."""
    every: int = 2
    """Control periods between samples; with 2 of 1/120 s the 3780 samples last 63 s."""
    period_s: float = 62.83185307179586
    """Period of the circle, s: "t / 10000" in the article, with t in milliseconds."""
    radius_mm: float = 100.0
    """Radius of the circle, mm."""
    settle_s: float = 2.0
    """Settling time from the target's start to the first sample, s."""
    gain: float = 4.0
    """The law's gain, 1/s."""


def run(config: SimulatedMovingConfig, seed: int, mapper: Mapper) -> pd.DataFrame:
    """See `vergence.eval.article.experiment.Experiment`."""
    jobs: list[Job] = [partial(_follow, config, seed, case, IMAGES, 0.0) for case in CASES]
    jobs += [partial(_follow, config, seed, case, NONE, 0.0) for case in CASES]
    tables: list[pd.DataFrame] = mapper(jobs)
    exact = tables[list(CASES).index("exact")]
    # noise of the same standard deviation, but white and without the detector's bias
    sigma = float(rows_where(exact, method="itpc")["detection_sigma_px"].iloc[0])
    tables += mapper([partial(_follow, config, seed, "exact", WHITE, sigma)])
    return pd.concat(tables, ignore_index=True)


def _follow(
    config: SimulatedMovingConfig, seed: int, case: str, noise: str, sigma_px: float
) -> pd.DataFrame:
    """Follow the target; returns a row for each sample and method."""
    nominal = load_head("simulated")
    loop = ClosedLoop(
        head=nominal, true_head=CASES[case].true_head(nominal, DRAWN_ERRORS, seed),
        target=CircleTarget(radius=config.radius_mm / MM, period=config.period_s),
        plant="kinematic", plant_options={"detection_noise_px": sigma_px}, samples=config.samples,
        every=config.every, settle_s=config.settle_s, gain=config.gain,
        seed=job_seed(seed, NAME, list(CASES).index(case)),
    )  # fmt: skip
    if noise == IMAGES:
        loop = replace(loop, plant="rendered", plant_options=BOARD)
    record = hold_gaze(loop)
    detected = record.pixels - record.true_pixels_at_exposure
    frames = []
    for method, error, time_s in (
        ("gaze", record.gaze_error_mm, record.time_s),
        ("itpc", record.itpc_error_mm, record.exposure_s),
        # the fix if the newest image is mistaken for the present
        ("itpc, undated", MM * (record.itpc.point - record.target), record.time_s),
    ):
        target = record.target_at_exposure if method == "itpc" else record.target
        rows = pd.DataFrame({"case": case, "noise": noise, "method": method,
                             "sample": np.arange(config.samples), "time_s": time_s})  # fmt: skip
        rows[["target_x_mm", "target_y_mm"]] = MM * target[:, :2]
        rows[["error_x_mm", "error_y_mm", "error_z_mm"]] = error
        rows["detection_sigma_px"] = float(np.sqrt(np.nanvar(detected, axis=0, ddof=1).mean()))
        frames.append(rows)
    return pd.concat(frames, ignore_index=True)


ARTICLE_NAME: Final = "simulated moving"
"""Name of this experiment in the table of the article's results."""
_row = partial(SummaryRow.of, ARTICLE_NAME)
RATES_HZ: Final = (120.0, 60.0, 30.0, 20.0, 15.0)
"""Frame rates at which the loop's noise gain is predicted, Hz (chosen)."""


def article_value_mm(quantity: str, method: str, axis: str) -> float:
    """A value that the article reports, mm."""
    return reported_result(ARTICLE_NAME, quantity, method, axis).low


class SampleErrors(NamedTuple):
    """Errors of one case and method over the samples, by axis, mm."""

    mean_absolute: dict[str, float]
    mean: dict[str, float]
    standard_deviation: dict[str, float]

    @classmethod
    def of(cls, samples: pd.DataFrame) -> "SampleErrors":
        """The errors of some samples."""
        columns = {axis: samples[f"error_{axis}_mm"] for axis in "xyz"}
        return cls(
            {axis: float(column.abs().mean()) for axis, column in columns.items()},
            {axis: float(column.mean()) for axis, column in columns.items()},
            {axis: float(column.std()) for axis, column in columns.items()},
        )

    @property
    def plane_mm(self) -> float:
        """Root mean square distance from the target in the circle's plane, mm."""
        square = (self.standard_deviation[axis] ** 2 + self.mean[axis] ** 2 for axis in "xy")
        return float(sum(square) ** 0.5)


Cases = dict[tuple[str, str, str], SampleErrors]
"""Errors by case, method and noise."""


def errors_by_case(table: pd.DataFrame) -> Cases:
    """The errors of all cases of a table."""
    return {
        (str(case), str(method), str(noise)): SampleErrors.of(samples)
        for (case, method, noise), samples in table.groupby(["case", "method", "noise"])
    }


def deviation_ratio(errors: Cases, case: str, noise: str = IMAGES) -> float:
    """Ratio of the standard deviations in z, gaze over ITPC."""
    gaze, itpc = errors[case, "gaze", noise], errors[case, "itpc", noise]
    return gaze.standard_deviation["z"] / itpc.standard_deviation["z"]


def article_deviation_ratio() -> float:
    """Ratio of the article's standard deviations in z, gaze over ITPC."""
    gaze, itpc = (article_value_mm("standard deviation", m, "z") for m in ("gaze", "itpc"))
    return gaze / itpc


def predicted_deviation_ratios(gain: float) -> dict[float, float]:
    """Ratio of scatter, gaze over ITPC, predicted from the loop's noise gain, by frame rate."""
    loop = LinearLoop.of(load_head("simulated"), gain)
    return {rate: noise_gain(loop.at_rate(rate)) for rate in RATES_HZ}


def expected_gaze_deviation_mm(errors: Cases, case: str, share: float) -> float:
    """Standard deviation in z expected of gaze, given the article's ITPC, mm.

    Gaze has the systematic part of a case, plus the fraction `share` of ITPC's scatter that the
    loop lets through.
    """
    systematic = errors[case, "gaze", NONE].standard_deviation["z"]
    itpc = article_value_mm("standard deviation", "itpc", "z")
    return hypot(systematic, share * max(itpc**2 - systematic**2, 0.0) ** 0.5)


def numbers(table: pd.DataFrame, config: SimulatedMovingConfig) -> Numbers:
    """The numbers of the text."""
    errors = errors_by_case(table)
    timing = load_head("simulated").timing
    speed = 2.0 * pi * config.radius_mm / config.period_s
    still, undated = errors["exact", "gaze", NONE], errors["exact", "itpc, undated", IMAGES]
    found = {
        "period_ms": 1000.0 * timing.period_s,
        "turn_percent": 100.0 * config.samples * config.every * timing.period_s / config.period_s,
        "speed_mm_s": speed,
        "trail_mm": still.plane_mm,
        "speed_over_gain_mm": speed / config.gain,
        "latency_way_mm": speed * timing.latency_s,
        "undated_plane_mm": undated.plane_mm,
        "ratio_exact": deviation_ratio(errors, "exact"),
        "ratio_white": deviation_ratio(errors, "exact", WHITE),
        "principal_systematic_z_mm": errors[ARTICLE_CASE, "gaze", NONE].standard_deviation["z"],
    }
    found |= {f"still_{axis}_mm": still.mean_absolute[axis] for axis in "xyz"}
    for method in ("gaze", "itpc"):
        for axis in "xyz":
            key = f"{method}_{axis}_mm"
            found[f"article_{key}"] = article_value_mm("mean absolute error", method, axis)
            for case in ("exact", ARTICLE_CASE):
                found[f"{case}_{key}"] = errors[case, method, IMAGES].mean_absolute[axis]
        found[f"article_{method}_scatter_mm"] = article_value_mm("standard deviation", method, "z")
        own = errors["exact", method, IMAGES]
        found[f"exact_{method}_scatter_mm"] = own.standard_deviation["z"]
    for rate, share in predicted_deviation_ratios(config.gain).items():
        found[f"ratio_predicted_{rate:g}_hz"] = share
        for case in ("exact", ARTICLE_CASE):
            expected = expected_gaze_deviation_mm(errors, case, share)
            found[f"expected_{case}_{rate:g}_hz_mm"] = expected
    return found


def summarise(table: pd.DataFrame, config: SimulatedMovingConfig) -> list[SummaryRow]:
    """Rows of the summary: the article's under its own camera matrix, then those of other cases."""
    errors = errors_by_case(table)
    rows = []
    for case in (ARTICLE_CASE, *(case for case in CASES if case != ARTICLE_CASE)):
        suffix = "" if case == ARTICLE_CASE else f", {CASES[case].title}"
        for row in reported_results():
            if row.experiment == ARTICLE_NAME:
                own = errors[case, row.method, IMAGES]
                scatter = row.quantity == "standard deviation"
                value = (own.standard_deviation if scatter else own.mean_absolute)[row.axis]
                rows.append(_row(row.quantity + suffix, row.method, row.axis, row.low, value))
    for axis in "xyz":
        for quantity, method, noise in (
            ("mean absolute error, exact model, no noise", "gaze", NONE),
            ("mean absolute error, exact model", "itpc, undated", IMAGES),
        ):
            value = errors["exact", method, noise].mean_absolute[axis]
            rows.append(_row(quantity, method, axis, None, value))
    for case in CASES:
        quantity = f"standard deviation, {CASES[case].title}, no noise"
        value = errors[case, "gaze", NONE].standard_deviation["z"]
        rows.append(_row(quantity, "gaze", "z", None, value))
    predicted = predicted_deviation_ratios(config.gain)
    measured = {CASES[case].title: deviation_ratio(errors, case) for case in CASES}
    measured["exact model, white noise"] = deviation_ratio(errors, "exact", WHITE)
    measured |= {f"predicted at {rate:g} Hz": share for rate, share in predicted.items()}
    for title, value in measured.items():
        quantity = f"standard deviation, gaze over ITPC, {title}"
        rows.append(_row(quantity, "both", "z", article_deviation_ratio(), value, unit="1"))
    for case in ("exact", ARTICLE_CASE):
        for rate, share in predicted.items():
            quantity = (
                f"standard deviation expected beside the article's ITPC, {CASES[case].title}, "
                f"{rate:g} Hz"
            )
            article = article_value_mm("standard deviation", "gaze", "z")
            value = expected_gaze_deviation_mm(errors, case, share)
            rows.append(_row(quantity, "gaze", "z", article, value))
    found = numbers(table, config)
    # the optical axes should trail the target by its speed over the gain
    wanted, trail = found["speed_over_gain_mm"], found["trail_mm"]
    verdict = "target met" if abs(trail - wanted) < 0.1 * wanted else "target missed"
    quantity = f"way behind the target, exact model, no noise, target {wanted:.3g} mm within 10 %"
    return [*rows, _row(quantity, "gaze", "x, y", None, trail, verdict)]


_DRAWN_EVERY: Final = 6
"""Step through the samples that are drawn (chosen: readability)."""


def draw(table: pd.DataFrame, config: SimulatedMovingConfig) -> dict[str, Figure]:
    """The figures by name."""
    return {
        "fig08-moving-target": _errors(table),
        "fig08-mean-absolute-errors": _bars(table),
        "fig08-noise-bandwidth": _ratios(table, config),
    }


def _errors(table: pd.DataFrame) -> Figure:
    figure = style.new_figure(9.5, 5.6)
    axes = figure.subplots(2, 3, sharex=True, sharey="col")
    for row, case in zip(axes, ("exact", ARTICLE_CASE), strict=True):
        for axis, letter in zip(row, "xyz", strict=True):
            for method in ("itpc", "gaze"):
                samples = rows_where(table, case=case, method=method, noise=IMAGES).iloc[
                    ::_DRAWN_EVERY
                ]
                look = style.METHOD_STYLE[method]
                axis.plot(
                    samples["time_s"], samples[f"error_{letter}_mm"], color=look["color"],
                    linestyle="-" if method == "gaze" else "none",
                    marker="" if method == "gaze" else ".", markersize=2.5,
                    label=look["label"],
                )  # fmt: skip
            article = article_value_mm("mean absolute error", "gaze", letter)
            for sign in (-1.0, 1.0):
                axis.axhline(sign * article, **style.ARTICLE_STYLE,
                             label="article: ± mean absolute error, gaze")  # fmt: skip
            axis.set_title(f"{letter}, {CASES[case].title}", fontsize=10)
        row[0].set_ylabel("error (mm)")
    for axis in axes[-1]:
        axis.set_xlabel("time (s)")
    style.legend_below(figure, 3, markerscale=3)
    return figure


def _bars(table: pd.DataFrame) -> Figure:
    errors = errors_by_case(table)
    figure = style.new_figure(9.5, 4.2)
    axes = figure.subplots(1, 3, sharey=True)
    methods = ("gaze", "itpc")
    colours, hatches = (style.GREEN, style.BLUE, style.ORANGE, style.PURPLE), ("", "//", "..", "xx")
    for axis, letter in zip(axes, "xyz", strict=True):
        for number, (case, colour, hatch) in enumerate(zip(CASES, colours, hatches, strict=False)):
            values = [errors[case, method, IMAGES].mean_absolute[letter] for method in methods]
            axis.bar(
                np.arange(2) + 0.25 * (number - 0.5 * (len(CASES) - 1)), values, 0.23,
                color=colour, hatch=hatch, edgecolor="white", label=CASES[case].title,
            )  # fmt: skip
        for place, method in enumerate(methods):
            axis.plot(
                [place - 0.42, place + 0.42],
                2 * [article_value_mm("mean absolute error", method, letter)],
                **{**style.ARTICLE_STYLE, "linewidth": 2.2}, label="article",
            )  # fmt: skip
        axis.set_xticks(range(2), ["gaze", "ITPC"])
        axis.set_title(letter)
        axis.set_axisbelow(True)
        style.log_axis(axis)
    axes[0].set_ylabel("mean absolute error (mm)")
    style.legend_below(figure, 2)
    return figure


def _ratios(table: pd.DataFrame, config: SimulatedMovingConfig) -> Figure:
    errors = errors_by_case(table)
    figure = style.new_figure(7.0, 4.0)
    axis = figure.subplots()
    gains = np.linspace(0.25, 4.5, 40)
    head = load_head("simulated")
    for rate, colour, dash in zip(
        RATES_HZ[:3], (style.BLUE, style.PURPLE, style.GREEN), ("-", "--", "-."), strict=True
    ):
        values = [noise_gain(LinearLoop.of(head, float(gain)).at_rate(rate)) for gain in gains]
        axis.plot(gains, values, color=colour, linestyle=dash, label=f"predicted at {rate:g} Hz")
    images, white = (deviation_ratio(errors, "exact", noise) for noise in (IMAGES, WHITE))
    axis.plot(config.gain, images, marker="o", markersize=9, color=style.ORANGE,
              linestyle="", label="measured, images, exact model")  # fmt: skip
    axis.plot(config.gain, white, marker="x", markersize=9, color=style.GREY,
              markeredgewidth=2, linestyle="", label="measured, white noise")  # fmt: skip
    axis.axhline(article_deviation_ratio(), **style.ARTICLE_STYLE, label="article: 0.30 / 0.98 mm")
    axis.set(
        xlabel="gain k (1/s)", ylabel="standard deviation in z,\ngaze over ITPC", ylim=(0.0, None)
    )
    style.legend_below(figure, 2)
    return figure


EXPERIMENT: Final = Experiment(
    name=NAME, title="A moving target on the simulated rig", article="Section 5.1.1, Figure 8",
    text=read_template(__package__, "sections/simulated_moving.jinja"),
    config=SimulatedMovingConfig, quick={"samples": 420},
    run=run, summarise=summarise, numbers=numbers, draw=draw,
)  # fmt: skip
