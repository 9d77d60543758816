"""Results of the uncertainties: summary rows, and the numbers of the text."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd

from vergence.eval.article.common.loop_noise import LinearLoop, noise_bandwidth_hz, noise_gain
from vergence.eval.article.experiment import SummaryRow
from vergence.eval.article.uncertainty.trials import AHEAD, ASIDE, NAME, UncertaintyConfig
from vergence.models.head_file import load_head
from vergence.reporting.text import Numbers

METHOD_NAMES: Final = {
    "gaze": "gaze, Eqs. 27 to 33",
    "gaze, exact": "gaze, exact derivatives",
    "itpc": "ITPC, Eqs. 34 to 36",
}
BIAS_RATIO: Final = 2.0
"""Ratio of the error of a mean to that of white noise, above which averaging is limited by a bias
(chosen)."""
IMPROVEMENT_RATIO: Final = 0.67
"""Ratio of a dithered to a still fixation's error below which dithering is better (chosen)."""


def rows_of_part(table: pd.DataFrame, name: str, quantity: str | None = None) -> pd.DataFrame:
    """Rows of one part of the experiment, of one quantity or of all."""
    rows = table[table["part"] == name]
    return rows if quantity is None else rows[rows["quantity"] == quantity]


def propagation_ratios(table: pd.DataFrame) -> pd.DataFrame:
    """Ratio of propagated to Monte Carlo uncertainty: a row per pose, depth and method, by axis."""
    rows = rows_of_part(table, "propagation")
    wide = rows[rows["unit"] == "mm"].pivot_table(
        index=["pose", "depth_mm", "method", "axis"], columns="quantity", values="value"
    )
    return (wide["propagated"] / wide["Monte Carlo"]).unstack("axis")


def averaged_errors_px(table: pd.DataFrame) -> pd.DataFrame:
    """Root mean square errors of means, px: a row per depth and kind of fixation, by frames."""
    rows = rows_of_part(table, "averaging", "error")
    square = rows.assign(value=rows["value"] ** 2)
    mean = square.groupby(["depth_mm", "fixation", "frames"])["value"].mean()
    return (mean**0.5).unstack("frames")


def cramer_rao_bounds_px(table: pd.DataFrame) -> pd.DataFrame:
    """Cramer-Rao bounds of one frame, px: a row per depth, columns `board` and `window`."""
    rows = rows_of_part(table, "bound")
    square = rows.assign(value=rows["value"] ** 2)
    mean = square.groupby(["depth_mm", "quantity"])["value"].mean()
    return (mean**0.5).unstack("quantity")


def noise_gains(table: pd.DataFrame, config: UncertaintyConfig) -> pd.DataFrame:
    """Measured and predicted noise gain: a row per source and gain.

    The column `chance` is three standard errors of their ratio: a record of T seconds has 2 B T
    independent values, with B the noise bandwidth, for each axis of each eye of each head.
    `excess_px` is the scatter of the optical axes beyond the prediction, as a root of the
    difference of squares.
    """
    rows = rows_of_part(table, "loop").pivot_table(
        index=["source", "gain_per_s"], columns="quantity", values="value"
    )
    rows = rows.reset_index().rename(columns={"noise gain": "measured"})
    head = load_head("simulated")
    loops = [LinearLoop.of(head, float(gain)) for gain in rows["gain_per_s"]]
    records = {
        "white noise": 4 * config.heads * config.loop_samples,
        "images": 4 * config.image_samples,
    }
    values = [
        2.0 * noise_bandwidth_hz(loop) * loop.period_s * records[source]
        for loop, source in zip(loops, rows["source"], strict=True)
    ]
    predicted = np.array([noise_gain(loop) for loop in loops])
    beyond = np.maximum(rows["measured"].to_numpy() ** 2 - predicted**2, 0.0)
    return rows.assign(
        predicted=predicted,
        chance=3.0 / np.sqrt(2.0 * np.asarray(values)),
        excess_px=np.sqrt(beyond) * rows["detection sigma"].to_numpy(),
    )


def bias_variation_px(table: pd.DataFrame) -> float:
    """Variation of the detector's bias over the sub-pixel range of the jittering axes, rms, px."""
    values = rows_of_part(table, "loop", "bias within reach")["value"]
    return float((values**2).mean() ** 0.5)


@dataclass(frozen=True, kw_only=True)
class AveragingErrors:
    """Errors before and after averaging, root mean square over all depths, px."""

    frames: int
    one_frame_px: float
    """Error of one frame, still fixation."""
    still_mean_px: float
    """Error of the mean of all frames, still fixation."""
    dithered_mean_px: float
    """Error of the mean of all frames, dithered fixation."""
    white_noise_mean_px: float
    """Error of the mean of all frames if single frames had only white scatter and no bias."""
    board_bound_px: float
    """Cramer-Rao bound for as many frames, from the whole board."""
    window_bound_px: float
    """Cramer-Rao bound for as many frames, from the detector's window."""


def averaging_errors(table: pd.DataFrame) -> AveragingErrors:
    """Errors before and after averaging."""
    errors, bound = averaged_errors_px(table), cramer_rao_bounds_px(table)
    frames = int(errors.columns.max())

    def rms(fixation: str, count: int) -> float:
        return float(np.sqrt((errors.xs(fixation, level="fixation")[count] ** 2).mean()))

    sigma = rows_of_part(table, "propagation", "detection sigma")["value"]
    root = float(np.sqrt(frames))
    return AveragingErrors(
        frames=frames,
        one_frame_px=rms("still", 1),
        still_mean_px=rms("still", frames),
        dithered_mean_px=rms("dithered", frames),
        white_noise_mean_px=float(np.sqrt((sigma**2).mean())) / root,
        board_bound_px=float(np.sqrt((bound["board"] ** 2).mean())) / root,
        window_bound_px=float(np.sqrt((bound["window"] ** 2).mean())) / root,
    )


def sigma_ratio_tolerance(config: UncertaintyConfig) -> float:
    """Deviation from 1 allowed by chance of a ratio of sample standard deviations: three errors."""
    return 3.0 / float(np.sqrt(config.draws))


def summarise(table: pd.DataFrame, config: UncertaintyConfig) -> list[SummaryRow]:
    """Rows of the summary, with our figures only; the article has none to compare with.

    The verdict is `agrees` or `differs` if two ways to obtain a figure are compared: propagation
    and Monte Carlo, or measured loops and their noise bandwidth, within three standard errors; a
    mean of frames and white noise, within the factor `BIAS_RATIO`. For dithering it is `better` or
    `alike`.
    """
    return [
        *_propagation_rows(table, config),
        *_loop_rows(table, config),
        *_averaging_rows(averaging_errors(table)),
    ]


def _propagation_rows(table: pd.DataFrame, config: UncertaintyConfig) -> Iterator[SummaryRow]:
    table_ratios = propagation_ratios(table)
    for pose in (AHEAD, ASIDE):
        for method, title in METHOD_NAMES.items():
            own = table_ratios.xs((pose, method), level=("pose", "method"))
            for axis in "xyz":
                low, high = float(own[axis].min()), float(own[axis].max())
                agrees = max(abs(low - 1.0), abs(high - 1.0)) <= sigma_ratio_tolerance(config)
                yield SummaryRow.of(
                    NAME, f"propagated over Monte Carlo, {pose}, {title}", method, axis, None,
                    (low, high), _agreement(agrees), "1",
                )  # fmt: skip


def _loop_rows(table: pd.DataFrame, config: UncertaintyConfig) -> Iterator[SummaryRow]:
    for loop in noise_gains(table, config).to_dict("records"):
        value = float(loop["measured"] / loop["predicted"])
        quantity = (
            f"axis scatter over detection noise at k = {loop['gain_per_s']:g}, {loop['source']}, "
            "over predicted"
        )
        agrees = abs(value - 1.0) <= loop["chance"]
        yield SummaryRow.of(NAME, quantity, "gaze", "u, v", None, value, _agreement(agrees), "1")
    quantity = "change of the bias in the images over what the axes wander"
    yield SummaryRow.of(NAME, quantity, "gaze", "u, v", None, bias_variation_px(table), unit="px")


def _averaging_rows(found: AveragingErrors) -> Iterator[SummaryRow]:
    for quantity, value in (
        ("error of one frame, root mean square", found.one_frame_px),
        (f"error of the mean of {found.frames} frames, still", found.still_mean_px),
        (f"error of the mean of {found.frames} frames, dithered", found.dithered_mean_px),
        (f"bound for {found.frames} frames, detector's window", found.window_bound_px),
        (f"bound for {found.frames} frames, whole board", found.board_bound_px),
    ):
        yield SummaryRow.of(NAME, quantity, "itpc", "u, v", None, value, unit="px")
    biased, dithered = (
        found.still_mean_px / found.white_noise_mean_px,
        found.dithered_mean_px / found.still_mean_px,
    )
    for quantity, ratio, verdict in (
        ("still, over what white noise would leave", biased, _agreement(biased <= BIAS_RATIO)),
        ("dithered, over still", dithered, "better" if dithered < IMPROVEMENT_RATIO else "alike"),
    ):
        yield SummaryRow.of(NAME, f"error of the mean of {found.frames} frames, {quantity}",
                            "itpc", "u, v", None, ratio, verdict, "1")  # fmt: skip


def _agreement(agrees: bool) -> str:
    return "agrees" if agrees else "differs"


def numbers(table: pd.DataFrame, config: UncertaintyConfig) -> Numbers:
    """The numbers of the text."""
    off = 100.0 * (propagation_ratios(table) - 1.0).abs().max(axis=1)
    aside = off.xs(ASIDE, level="pose")
    gains = noise_gains(table, config)
    gains["off"] = 100.0 * (gains["measured"] / gains["predicted"] - 1.0).abs()
    white = gains[gains["source"] == "white noise"]
    images = gains[gains["source"] == "images"].sort_values("gain_per_s")
    last, found = images.iloc[-1], averaging_errors(table)
    root = float(np.sqrt(found.frames))
    return {
        "points_count": float(len(off.xs((AHEAD, "gaze"), level=("pose", "method")))),
        "aside_count": float(len(off.xs((ASIDE, "gaze"), level=("pose", "method")))),
        "tolerance_percent": 100.0 * sigma_ratio_tolerance(config),
        "ahead_percent": float(off.xs(AHEAD, level="pose").max()),
        "aside_article_percent": float(aside.xs("gaze", level="method").max()),
        "aside_exact_percent": float(aside.xs("gaze, exact", level="method").max()),
        "loop_gain_per_s": float(last["gain_per_s"]),
        "axes_ratio": float(last["measured"]),
        "axes_predicted_ratio": float(last["predicted"]),
        "propagated_ratio": 1.0 / float(last["measured"]),
        "white_off_percent": float(white["off"].max()),
        "images_off_percent": float(images["off"].max()),
        "beyond_count": float((images["off"] > 100.0 * images["chance"]).sum()),
        "images_count": float(len(images)),
        "excess_least_px": float(images["excess_px"].min()),
        "excess_greatest_px": float(images["excess_px"].max()),
        "bias_within_reach_px": bias_variation_px(table),
        "frames_count": found.frames,
        "single_px": found.one_frame_px,
        "still_px": found.still_mean_px,
        "white_px": found.white_noise_mean_px,
        "dithered_px": found.dithered_mean_px,
        "window_px": found.window_bound_px,
        "board_px": found.board_bound_px,
        "still_over_dithered_ratio": found.still_mean_px / found.dithered_mean_px,
        "dithered_over_window_ratio": found.dithered_mean_px / found.window_bound_px,
        "dithered_over_board_ratio": found.dithered_mean_px / found.board_bound_px,
        "single_over_window_ratio": found.one_frame_px / found.window_bound_px / root,
        "single_over_board_ratio": found.one_frame_px / found.board_bound_px / root,
    }
