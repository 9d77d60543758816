"""What propagated uncertainties, closed-loop scatter and averaging come to."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd

from vergence.eval.article.common.loop_noise import Loop, noise_bandwidth_hz, noise_gain
from vergence.eval.article.experiment import SummaryRow
from vergence.eval.article.uncertainty.trials import AHEAD, ASIDE, UncertaintyConfig
from vergence.models.files.head_file import load_head

EXPERIMENT: Final = "uncertainty"
METHOD_NAMES: Final = {
    "gaze": "gaze, Eqs. 27 to 33",
    "gaze, exact": "gaze, exact derivatives",
    "itpc": "ITPC, Eqs. 34 to 36",
}
_UNREPORTED: Final = "not reported"


def part(table: pd.DataFrame, name: str, quantity: str | None = None) -> pd.DataFrame:
    """The rows of one part of the experiment, of one quantity or of all."""
    rows = table[table["part"] == name]
    return rows if quantity is None else rows[rows["quantity"] == quantity]


def ratios(table: pd.DataFrame) -> pd.DataFrame:
    """Propagated uncertainty over Monte Carlo's: a row a pose, depth and method, by axis."""
    rows = part(table, "propagation")
    wide = rows[rows["unit"] == "mm"].pivot_table(
        index=["pose", "depth_mm", "method", "axis"], columns="quantity", values="value"
    )
    return (wide["propagated"] / wide["Monte Carlo"]).unstack("axis")


def averaged(table: pd.DataFrame) -> pd.DataFrame:
    """Root mean square errors of means, px: a row a depth and kind of fixation, by frames."""
    rows = part(table, "averaging", "error")
    square = rows.assign(value=rows["value"] ** 2)
    mean = square.groupby(["depth_mm", "fixation", "frames"])["value"].mean()
    return (mean**0.5).unstack("frames")


def bounds(table: pd.DataFrame) -> pd.DataFrame:
    """Cramer-Rao bounds of one frame, px: a row a depth, columns `board` and `window`."""
    rows = part(table, "bound")
    square = rows.assign(value=rows["value"] ** 2)
    mean = square.groupby(["depth_mm", "quantity"])["value"].mean()
    return (mean**0.5).unstack("quantity")


def noise_gains(table: pd.DataFrame, config: UncertaintyConfig) -> pd.DataFrame:
    """Measured and predicted noise gain: a row a source and gain.

    The column `chance` is three standard errors of their ratio: a record of T seconds has 2 B T
    independent values, with B the noise bandwidth, for each axis of each eye of each head.
    `excess_px` is what the axes scatter by beyond the prediction, in squares.
    """
    rows = part(table, "loop").pivot_table(
        index=["source", "gain_per_s"], columns="quantity", values="value"
    )
    rows = rows.reset_index().rename(columns={"noise gain": "measured"})
    head = load_head("simulated")
    loops = [Loop.of(head, float(gain)) for gain in rows["gain_per_s"]]
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


def bias_within_reach(table: pd.DataFrame) -> float:
    """How much the detector's bias varies over the places that the axes reach, rms, px."""
    values = part(table, "loop", "bias within reach")["value"]
    return float((values**2).mean() ** 0.5)


@dataclass(frozen=True, kw_only=True)
class Averaging:
    """What averaging gains, over all depths, px."""

    frames: int
    single_px: float
    """Root mean square error of one frame, still."""
    still_px: float
    dithered_px: float
    """The same of the mean of all frames."""
    white_px: float
    """What it would be if a frame's scatter were all there is."""
    board_px: float
    """The bound for as many frames, from the whole board."""
    window_px: float
    """The bound for as many frames, from the detector's window."""


def averaging(table: pd.DataFrame) -> Averaging:
    """What averaging gains."""
    errors, bound = averaged(table), bounds(table)
    frames = int(errors.columns.max())

    def rms(fixation: str, count: int) -> float:
        return float(np.sqrt((errors.xs(fixation, level="fixation")[count] ** 2).mean()))

    sigma = part(table, "propagation", "detection sigma")["value"]
    root = float(np.sqrt(frames))
    return Averaging(
        frames=frames,
        single_px=rms("still", 1),
        still_px=rms("still", frames),
        dithered_px=rms("dithered", frames),
        white_px=float(np.sqrt((sigma**2).mean())) / root,
        board_px=float(np.sqrt((bound["board"] ** 2).mean())) / root,
        window_px=float(np.sqrt((bound["window"] ** 2).mean())) / root,
    )


def tolerance(config: UncertaintyConfig) -> float:
    """How far a ratio of sample standard deviations may be from 1 by chance: three errors."""
    return 3.0 / float(np.sqrt(config.draws))


def summarise(table: pd.DataFrame, config: UncertaintyConfig) -> list[SummaryRow]:
    """Figures of our own; the article has none to compare with.

    The verdict is `agrees` or `differs` where two ways to one figure are compared: propagation
    and Monte Carlo, loops and their noise bandwidth; within three standard errors they agree.
    """
    rows = []
    table_ratios = ratios(table)
    for pose in (AHEAD, ASIDE):
        for method, title in METHOD_NAMES.items():
            own = table_ratios.xs((pose, method), level=("pose", "method"))
            for axis in "xyz":
                low, high = float(own[axis].min()), float(own[axis].max())
                agrees = max(abs(low - 1.0), abs(high - 1.0)) <= tolerance(config)
                rows.append(
                    _row(f"propagated over Monte Carlo, {pose}, {title}", method, axis, "1",
                         low, high, "agrees" if agrees else "differs")
                )  # fmt: skip
    for loop in noise_gains(table, config).to_dict("records"):
        value = float(loop["measured"] / loop["predicted"])
        quantity = (
            f"axis scatter over detection noise at k = {loop['gain_per_s']:g}, {loop['source']}, "
            "over predicted"
        )
        verdict = "agrees" if abs(value - 1.0) <= loop["chance"] else "differs"
        rows.append(_row(quantity, "gaze", "u, v", "1", value, value, verdict))
    reach = bias_within_reach(table)
    quantity = "change of the bias in the images over what the axes wander"
    rows.append(_row(quantity, "gaze", "u, v", "px", reach, reach, _UNREPORTED))
    found = averaging(table)
    for quantity, value in (
        ("error of one frame, root mean square", found.single_px),
        (f"error of the mean of {found.frames} frames, still", found.still_px),
        (f"error of the mean of {found.frames} frames, dithered", found.dithered_px),
        (f"bound for {found.frames} frames, detector's window", found.window_px),
        (f"bound for {found.frames} frames, whole board", found.board_px),
    ):
        rows.append(_row(quantity, "itpc", "u, v", "px", value, value, _UNREPORTED))
    return rows


def _row(
    quantity: str, method: str, axis: str, unit: str, low: float, high: float, verdict: str
) -> SummaryRow:
    return SummaryRow(
        experiment=EXPERIMENT, quantity=quantity, method=method, axis=axis, unit=unit,
        article_low=None, article_high=None, ours_low=low, ours_high=high, verdict=verdict,
    )  # fmt: skip


def conclude(table: pd.DataFrame, config: UncertaintyConfig) -> str:
    """What the numbers say, in one paragraph."""
    return " ".join(
        (_propagated(table, config), _scatter(table, config), _limits(averaging(table)))
    )


def _propagated(table: pd.DataFrame, config: UncertaintyConfig) -> str:
    off = (ratios(table) - 1.0).abs().max(axis=1)
    ahead = float(off.xs(AHEAD, level="pose").max())
    aside = off.xs(ASIDE, level="pose")
    article = float(aside.xs("gaze", level="method").max())
    exact = float(aside.xs("gaze, exact", level="method").max())
    limit = tolerance(config)
    return (
        f"Straight ahead, Eqs. 27 to 36 differ from Monte Carlo with the real detector by at most "
        f"{100.0 * ahead:.1f} %, "
        + ("as chance allows" if ahead <= limit else "more than chance allows")
        + f" ({100.0 * limit:.1f} %); at {config.aside_deg:g} degrees to the side Eqs. 27 to 33 "
        f"differ by up to {100.0 * article:.1f} % and the exact derivatives by "
        f"{100.0 * exact:.1f} %"
        + (
            ", since tilting a panned eye moves the image by less than they say."
            if article > limit >= exact
            else "."
        )
    )


def _scatter(table: pd.DataFrame, config: UncertaintyConfig) -> str:
    gains = noise_gains(table, config)
    off = (gains["measured"] / gains["predicted"] - 1.0).abs()
    images = gains["source"] == "images"
    last = gains[images].sort_values("gain_per_s").to_dict("records")[-1]
    beyond = int((off > gains["chance"])[images].sum())
    sentence = (
        f"In the closed loop with images the axes scatter {last['measured']:.3f} times as much as "
        f"the detections at k = {last['gain_per_s']:g}, so Eqs. 31 to 33 give "
        f"{1.0 / last['measured']:.1f} times the scatter of gaze that one sees. The loop's noise "
        f"bandwidth predicts {last['predicted']:.3f}; for white noise it is off by at most "
        f"{100.0 * float(off[~images].max()):.1f} % at any gain, for images by "
        f"{100.0 * float(off[images].max()):.0f} %"
    )
    if beyond == 0:
        return sentence + ", within three standard errors."
    bias, excess = bias_within_reach(table), gains["excess_px"][images]
    low, high = float(excess.min()), float(excess.max())
    return sentence + (
        f", beyond three standard errors in {beyond} of {int(images.sum())} records. The excess is "
        f"{low:.4f} to {high:.4f} px; the bias in the images varies by {bias:.4f} px over the "
        "thousandths of a pixel that the axes wander, "
        + (
            "which is of that size, and what is slow passes the loop."
            if 0.5 * low <= bias <= 2.0 * high
            else "which does not explain it."
        )
    )


def _limits(found: Averaging) -> str:
    floor = found.still_px > 2.0 * found.white_px
    helps = found.dithered_px < 0.67 * found.still_px
    return (
        f"One frame is off by {found.single_px:.4f} px, {found.frames} frames of a still target by "
        f"{found.still_px:.4f} px"
        + (
            ": averaging ends at the detector's bias at that place in the pixel "
            f"({found.white_px:.4f} px if there were none). "
            if floor
            else f", about what its scatter alone gives ({found.white_px:.4f} px). "
        )
        + f"Dithered over a pixel, as many frames are off by {found.dithered_px:.4f} px, "
        + (
            f"{found.still_px / found.dithered_px:.1f} times less. "
            if helps
            else "which is not much better. "
        )
        + f"The Cramer-Rao bound for them is {found.window_px:.5f} px from the window around the "
        f"corner that the detector uses and {found.board_px:.5f} px from the whole board: dithered "
        f"averaging stays {found.dithered_px / found.window_px:.1f} and "
        f"{found.dithered_px / found.board_px:.0f} times above these, a single frame "
        f"{found.single_px / found.window_px / found.frames**0.5:.1f} and "
        f"{found.single_px / found.board_px / found.frames**0.5:.0f} times above its own."
    )
