"""Uncertainty: propagated, by Monte Carlo, in the closed loop, and its lower bound."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from vergence.eval.article import closed_loop
from vergence.eval.article.board_views import (
    FixedView,
    board_poses_in_eyes,
    cramer_rao_bound,
    shifted_pose,
)
from vergence.eval.article.closed_loop import MM, ClosedLoop, LinearLoop, hold_gaze, noise_gain
from vergence.eval.article.experiment import Experiment, SummaryRow, job_rng, job_seed, rows_where
from vergence.eval.article.reported import static_points
from vergence.eval.article.simulated_moving import article_deviation_ratio
from vergence.eval.article.simulated_static import (
    ARTICLE_DETECTION_PX,
    BOARD,
    article_result,
    depth_panels,
)
from vergence.models.head_file import load_head
from vergence.models.parts import FloatArray
from vergence.reporting import style
from vergence.reporting.jobs import Job, Mapper
from vergence.reporting.text import Numbers, read_template
from vergence.triangulation import Noise, triangulate_gaze, triangulate_views

NAME: Final = "uncertainty"
AHEAD: Final = "ahead"
ASIDE: Final = "aside"
# Keys of the random streams, one per kind of trial (numerical).
_PROPAGATION, _LOOP, _LOOP_IMAGES, _AVERAGING, _REACH = range(5)
_REACH_PX: Final = 0.004
"""Half range of the optical axes' jitter in the image, px (chosen: about twice their standard
deviation at a gain of 4)."""


@dataclass(frozen=True, kw_only=True)
class UncertaintyConfig:
    """Configuration of the uncertainties."""

    draws: int = 1150
    """Images of each eye at a fixed pose."""
    point_step: int = 1
    """Step through Table 3's 21 points, from the first."""
    aside_deg: float = 25.0
    """Angle to the side at which every fifth of these points is used once more, degrees."""
    gains: tuple[float, ...] = (0.5, 1.0, 2.0, 3.0, 4.0)
    """Gains of the closed loops with white noise, 1/s."""
    heads: int = 100
    """Number of heads side by side at each of those gains."""
    loop_samples: int = 1200
    """Control periods recorded of each of these loops."""
    image_gains: tuple[float, ...] = (1.0, 2.0, 4.0)
    """Gains of the closed loops with images, 1/s."""
    image_samples: int = 3000
    """Control periods recorded of each loop with images."""
    image_depth_m: float = 2.0
    """Depth of the board for the loops with images, m."""
    reach_draws: int = 400
    """Images at each of nine sub-pixel offsets within the axes' jitter, for the bias there."""
    averaging_depths_m: tuple[float, ...] = (1.0, 1.5, 2.5)
    """Depths at which averaging is measured, m."""
    frames: int = 1024
    """Largest number of averaged frames."""
    replicates: int = 10
    """Number of averages at each depth, each at another sub-pixel position."""
    dither_side: int = 4
    """References per side of a dithered fixation, see `closed_loop.dither_references_px`."""


def run(config: UncertaintyConfig, seed: int, mapper: Mapper) -> pd.DataFrame:
    """See `vergence.eval.article.experiment.Experiment`."""
    points = range(0, len(static_points("simulated")), config.point_step)
    jobs: list[Job] = [partial(_propagation, config, seed, point, AHEAD) for point in points]
    jobs += [partial(_propagation, config, seed, point, ASIDE) for point in list(points)[::5]]
    jobs += [partial(_loop, config, seed, number) for number in range(len(config.gains))]
    jobs += [partial(_loop_images, config, seed, i) for i in range(len(config.image_gains))]
    jobs += [partial(_bias_within_reach, config, seed, axis) for axis in range(2)]
    jobs += [
        partial(_averaging, config, seed, depth, replicate)
        for depth in range(len(config.averaging_depths_m))
        for replicate in range(config.replicates)
    ]
    return pd.DataFrame([row for rows in mapper(jobs) for row in rows])


Values = list[dict[str, Any]]
"""Rows of the table."""


def _value(part: str, quantity: str, unit: str, value: float, **keys: Any) -> dict[str, Any]:
    return {"part": part, **keys, "quantity": quantity, "unit": unit, "value": float(value)}


def _propagation(config: UncertaintyConfig, seed: int, index: int, pose: str) -> Values:
    """(a) Uncertainties at one pose: propagated, and by Monte Carlo with the real detector."""
    head = load_head("simulated")
    point = static_points("simulated")[index]
    if pose == ASIDE:
        point[0] -= point[2] * np.tan(np.deg2rad(config.aside_deg))
    q = head.fixate(point)
    boards = board_poses_in_eyes(head, q, point)
    rng = job_rng(seed, NAME, _PROPAGATION, index, int(pose == ASIDE))
    pixels = np.stack(
        [FixedView(head, eye).detect([boards[eye]] * config.draws, rng) for eye in range(2)], axis=1
    )
    sigma, truth = closed_loop.detection_sigma(pixels), head.project(q, point)
    mean = np.nanmean(pixels, axis=0)
    error = pixels - head.cameras.principal  # no lens distorts on this rig
    gaze = closed_loop.corrected_gaze_fix(
        head, np.broadcast_to(q, (len(pixels), 7)), error, boards[:, 2, 3]
    )
    itpc = triangulate_views(head, q, pixels)
    propagated = {
        "gaze": closed_loop.gaze_uncertainty_mm(head, q, sigma),
        "gaze, exact": MM * triangulate_gaze(head, q, Noise(pixel_px=sigma)).sigma,
        "itpc": closed_loop.itpc_uncertainty_mm(head, q, mean, sigma),
    }
    scatter = {
        name: MM * np.nanstd(fix.point, axis=0, ddof=1)
        for name, fix in (("gaze", gaze), ("gaze, exact", gaze), ("itpc", itpc))
    }
    rows = [
        _value(
            "propagation", quantity, "mm", values[method][axis],
            pose=pose, depth_mm=MM * point[2], method=method, axis=letter,
        )
        for quantity, values in (("propagated", propagated), ("Monte Carlo", scatter))
        for method in propagated
        for axis, letter in enumerate("xyz")
    ]  # fmt: skip
    for axis, letter in enumerate("uv"):
        for quantity, value in (
            ("detection sigma", np.sqrt((sigma[:, axis] ** 2).mean())),
            ("detection bias", np.sqrt(((mean - truth)[:, axis] ** 2).mean())),
        ):
            keys = {"pose": pose, "depth_mm": MM * point[2], "axis": letter}
            rows.append(_value("propagation", quantity, "px", value, **keys))
    return rows


def _loop_at(depth_m: float, gain: float, seed: int) -> ClosedLoop:
    return ClosedLoop(
        head=load_head("simulated"), samples=1, settle_s=4.0 / gain, gain=gain, seed=seed,
        target={"kind": "static", "point": (0.0, -0.1, depth_m), "start": "fixation"},
    )  # fmt: skip


def _loop(config: UncertaintyConfig, seed: int, number: int) -> list[dict[str, Any]]:
    """(b) Noise gain (axis scatter over detection noise) of loops with white noise, no images."""
    gain = config.gains[number]
    loop = _loop_at(1.0, gain, seed=job_seed(seed, NAME, _LOOP, number))
    record = hold_gaze(
        replace(loop, plant="kinematic", num=config.heads, samples=config.loop_samples)
    )
    # without bias the optical axes scatter around the target itself
    axis_px = record.true_pixels_at_exposure - load_head("simulated").cameras.principal
    return _scatter("white noise", gain, np.sqrt((axis_px**2).mean()), _noise(record))


def _loop_images(config: UncertaintyConfig, seed: int, number: int) -> list[dict[str, Any]]:
    """(b) Noise gain of one head's loop with images; scatter about the mean."""
    gain = config.image_gains[number]
    loop = _loop_at(config.image_depth_m, gain, seed=job_seed(seed, NAME, _LOOP_IMAGES, number))
    record = hold_gaze(replace(loop, plant_options=BOARD, samples=config.image_samples))
    sigma = np.sqrt(record.true_pixels_at_exposure.var(axis=0).mean())
    return _scatter("images", gain, sigma, _noise(record))


def _bias_within_reach(config: UncertaintyConfig, seed: int, axis: int) -> list[dict[str, Any]]:
    """(b) Variation of the bias in rendered images over the range of the axes' jitter."""
    head = load_head("simulated")
    point = np.array([0.0, -0.1, config.image_depth_m])
    board = board_poses_in_eyes(head, head.fixate(point), point)[0]
    view = FixedView(head, 0)
    rng = job_rng(seed, NAME, _REACH, axis)
    means, squares = [], []
    for offset in np.linspace(-_REACH_PX, _REACH_PX, 9):
        pose = shifted_pose(head, 0, board, offset * np.eye(2)[axis])
        error = view.detect([pose] * config.reach_draws, rng)[:, axis] - view.true_pixel(pose)[axis]
        means.append(np.nanmean(error))
        squares.append(np.nanvar(error, ddof=1) / config.reach_draws)
    # subtract the variance of the means due to noise
    bias = np.sqrt(max(np.var(means, ddof=1) - np.mean(squares), 0.0))
    return [_value("loop", "bias within reach", "px", bias, source="images", axis="uv"[axis])]


def _noise(record: Any) -> float:
    noise = record.pixels - record.true_pixels_at_exposure
    return float(np.sqrt(np.nanvar(noise, axis=0).mean()))


def _scatter(source: str, gain: float, axis_px: float, noise_px: float) -> list[dict[str, Any]]:
    keys = {"source": source, "gain_per_s": gain}
    return [
        _value("loop", "axis sigma", "px", axis_px, **keys),
        _value("loop", "detection sigma", "px", noise_px, **keys),
        _value("loop", "noise gain", "1", axis_px / noise_px, **keys),
    ]


def _averaging(config: UncertaintyConfig, seed: int, index: int, replicate: int) -> Values:
    """(c) Errors of means of n frames of one eye, still and dithered; the bound of one frame."""
    head = load_head("simulated")
    depth = config.averaging_depths_m[index]
    point = np.array([0.0, -0.1, depth])
    rng = job_rng(seed, NAME, _AVERAGING, index, replicate)
    centred = board_poses_in_eyes(head, head.fixate(point), point)[0]
    board = shifted_pose(head, 0, centred, rng.uniform(-0.5, 0.5, 2))
    view = FixedView(head, 0)
    references = np.asarray(closed_loop.dither_references_px(config.dither_side))
    order = rng.permutation(np.arange(config.frames) % len(references))
    keys = {"depth_mm": MM * depth, "replicate": replicate}
    rows = []
    for fixation, poses in (
        ("still", [board] * config.frames),
        ("dithered", [shifted_pose(head, 0, board, references[place]) for place in order]),
    ):
        truth = np.stack([view.true_pixel(pose) for pose in poses])
        error = view.detect(poses, rng) - truth
        for frames, mean in _means(error):
            for axis, letter in enumerate("uv"):
                more = {"fixation": fixation, "axis": letter, "frames": frames}
                rows.append(_value("averaging", "error", "px", mean[axis], **more, **keys))
    for window, sigma in zip(("board", "window"), cramer_rao_bound(head, 0, board), strict=True):
        rows += [
            _value("bound", window, "px", sigma[axis], axis=letter, frames=1, **keys)
            for axis, letter in enumerate("uv")
        ]
    return rows


def _means(error: FloatArray) -> Iterator[tuple[int, FloatArray]]:
    """Means of the first n errors for n = 1, 4, 16 and so on, and of all."""
    frames = 1
    while frames < len(error):
        yield frames, np.nanmean(error[:frames], axis=0)
        frames *= 4
    yield len(error), np.nanmean(error, axis=0)


_row = partial(SummaryRow.of, NAME)
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
    rows = rows_where(table, part=name)
    return rows if quantity is None else rows_where(rows, quantity=quantity)


def propagation_ratios(table: pd.DataFrame) -> pd.DataFrame:
    """Ratio of propagated to Monte Carlo uncertainty: a row per pose, depth and method, by axis."""
    rows = rows_of_part(table, "propagation")
    wide = rows_where(rows, unit="mm").pivot_table(
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
        2.0 * closed_loop.noise_bandwidth_hz(loop) * loop.period_s * records[source]
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


class AveragingErrors(NamedTuple):
    """Errors before and after averaging, root mean square over all depths, px."""

    frames_count: int
    single_px: float
    """Error of one frame, still fixation."""
    still_px: float
    """Error of the mean of all frames, still fixation."""
    white_px: float
    """Error of the mean of all frames if single frames had only white scatter and no bias."""
    dithered_px: float
    """Error of the mean of all frames, dithered fixation."""
    window_px: float
    """Cramer-Rao bound for as many frames, from the detector's window."""
    board_px: float
    """Cramer-Rao bound for as many frames, from the whole board."""


def averaging_errors(table: pd.DataFrame) -> AveragingErrors:
    """Errors before and after averaging."""
    errors, bound = averaged_errors_px(table), cramer_rao_bounds_px(table)
    frames = int(errors.columns.max())

    def rms(fixation: str, count: int) -> float:
        return float(np.sqrt((errors.xs(fixation, level="fixation")[count] ** 2).mean()))

    def rms_of_mean(values: "pd.Series[float]") -> float:
        return float(np.sqrt((values**2).mean())) / float(np.sqrt(frames))

    sigma = rows_of_part(table, "propagation", "detection sigma")["value"]
    return AveragingErrors(
        frames, rms("still", 1), rms("still", frames), rms_of_mean(sigma), rms("dithered", frames),
        rms_of_mean(bound["window"]), rms_of_mean(bound["board"]),
    )  # fmt: skip


def sigma_ratio_tolerance(config: UncertaintyConfig) -> float:
    """Deviation from 1 allowed by chance of a ratio of sample standard deviations: three errors."""
    return 3.0 / float(np.sqrt(config.draws))


def summarise(table: pd.DataFrame, config: UncertaintyConfig) -> list[SummaryRow]:
    """Rows of the summary, with our figures only; the article has none to compare with."""
    averaging = _averaging_rows(averaging_errors(table))
    return [*_propagation_rows(table, config), *_loop_rows(table, config), *averaging]


def _propagation_rows(table: pd.DataFrame, config: UncertaintyConfig) -> Iterator[SummaryRow]:
    table_ratios = propagation_ratios(table)
    for pose in (AHEAD, ASIDE):
        for method, title in METHOD_NAMES.items():
            own = table_ratios.xs((pose, method), level=("pose", "method"))
            for axis in "xyz":
                low, high = float(own[axis].min()), float(own[axis].max())
                agrees = max(abs(low - 1.0), abs(high - 1.0)) <= sigma_ratio_tolerance(config)
                quantity = f"propagated over Monte Carlo, {pose}, {title}"
                yield _row(quantity, method, axis, None, (low, high), _agreement(agrees), "1")


def _loop_rows(table: pd.DataFrame, config: UncertaintyConfig) -> Iterator[SummaryRow]:
    for loop in noise_gains(table, config).to_dict("records"):
        value = float(loop["measured"] / loop["predicted"])
        quantity = (
            f"axis scatter over detection noise at k = {loop['gain_per_s']:g}, {loop['source']}, "
            "over predicted"
        )
        agrees = abs(value - 1.0) <= loop["chance"]
        yield _row(quantity, "gaze", "u, v", None, value, _agreement(agrees), "1")
    quantity = "change of the bias in the images over what the axes wander"
    yield _row(quantity, "gaze", "u, v", None, bias_variation_px(table), unit="px")


def _averaging_rows(found: AveragingErrors) -> Iterator[SummaryRow]:
    for quantity, value in (
        ("error of one frame, root mean square", found.single_px),
        (f"error of the mean of {found.frames_count} frames, still", found.still_px),
        (f"error of the mean of {found.frames_count} frames, dithered", found.dithered_px),
        (f"bound for {found.frames_count} frames, detector's window", found.window_px),
        (f"bound for {found.frames_count} frames, whole board", found.board_px),
    ):
        yield _row(quantity, "itpc", "u, v", None, value, unit="px")
    biased = found.still_px / found.white_px
    dithered = found.dithered_px / found.still_px
    for quantity, ratio, verdict in (
        ("still, over what white noise would leave", biased, _agreement(biased <= BIAS_RATIO)),
        ("dithered, over still", dithered, "better" if dithered < IMPROVEMENT_RATIO else "alike"),
    ):
        quantity = f"error of the mean of {found.frames_count} frames, {quantity}"
        yield _row(quantity, "itpc", "u, v", None, ratio, verdict, "1")


def _agreement(agrees: bool) -> str:
    return "agrees" if agrees else "differs"


def numbers(table: pd.DataFrame, config: UncertaintyConfig) -> Numbers:
    """The numbers of the text."""
    off = 100.0 * (propagation_ratios(table) - 1.0).abs().max(axis=1)
    aside = off.xs(ASIDE, level="pose")
    gains = noise_gains(table, config)
    gains["off"] = 100.0 * (gains["measured"] / gains["predicted"] - 1.0).abs()
    white = rows_where(gains, source="white noise")
    images = rows_where(gains, source="images").sort_values("gain_per_s")
    last, found = images.iloc[-1], averaging_errors(table)
    root = float(np.sqrt(found.frames_count))
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
        **found._asdict(),
        "still_over_dithered_ratio": found.still_px / found.dithered_px,
        "dithered_over_window_ratio": found.dithered_px / found.window_px,
        "dithered_over_board_ratio": found.dithered_px / found.board_px,
        "single_over_window_ratio": found.single_px / found.window_px / root,
        "single_over_board_ratio": found.single_px / found.board_px / root,
    }


def draw(table: pd.DataFrame, config: UncertaintyConfig) -> dict[str, Figure]:
    """The figures by name."""
    return {
        "uncertainty-propagated": _propagated(table),
        "uncertainty-noise-bandwidth": _draw_loop(table, config),
        "uncertainty-averaging": _draw_averaging(table),
    }


def _propagated(table: pd.DataFrame) -> Figure:
    figure = style.new_figure(9.5, 4.6)
    axes = depth_panels(figure, "uncertainty, standard deviation (mm)")
    rows = rows_of_part(table, "propagation")
    rows = rows_where(rows, unit="mm", pose=AHEAD)
    for axis, letter in zip(axes, "xyz", strict=True):
        own = rows_where(rows, axis=letter).sort_values("depth_mm")
        article = article_result("uncertainty", letter)
        axis.axhspan(*article.span, **style.ARTICLE_BAND, label="article's range")
        for method in ("gaze", "itpc"):
            look = style.METHOD_STYLE[method]
            for quantity in ("propagated", "Monte Carlo"):
                values = rows_where(own, method=method, quantity=quantity)
                line = quantity == "propagated"
                axis.plot(
                    values["depth_mm"] / 1000.0, values["value"], color=look["color"],
                    linestyle=look["linestyle"] if line else "none",
                    marker="" if line else look["marker"], markerfacecolor="none",
                    label=METHOD_NAMES[method] if line else f"{look['label']}, Monte Carlo",
                )  # fmt: skip
    style.legend_below(figure, 3)
    return figure


def _draw_loop(table: pd.DataFrame, config: UncertaintyConfig) -> Figure:
    figure = style.new_figure(7.0, 4.2)
    axis = figure.subplots()
    measured = noise_gains(table, config)
    head = load_head("simulated")
    gains = np.linspace(0.1, max(4.5, float(measured["gain_per_s"].max())), 60)
    predicted = [noise_gain(LinearLoop.of(head, float(gain))) for gain in gains]
    axis.plot(gains, predicted, color=style.BLACK, label="from the noise bandwidth")
    for source, colour, marker in (("white noise", style.BLUE, "x"), ("images", style.ORANGE, "o")):
        own = rows_where(measured, source=source)
        axis.plot(own["gain_per_s"], own["measured"], color=colour, marker=marker, linestyle="",
                  markersize=8, markeredgewidth=2, label=f"measured, {source}")  # fmt: skip
    ratio, label = article_deviation_ratio(), "article, moving target: 0.30 / 0.98 mm"
    axis.axhline(ratio, **style.ARTICLE_STYLE, label=label)
    axis.set(
        xlabel="gain k (1/s)",
        ylabel="scatter of the axes\nover that of detections",
        ylim=(0.0, None),
    )
    style.legend_below(figure, 2)
    return figure


def _draw_averaging(table: pd.DataFrame) -> Figure:
    errors, bound = averaged_errors_px(table), cramer_rao_bounds_px(table)
    depths = list(bound.index)
    figure = style.new_figure(9.5 if len(depths) > 1 else 6.0, 4.8)
    axes = figure.subplots(1, len(depths), sharey=True, squeeze=False)[0]
    for axis, depth in zip(axes, depths, strict=True):
        frames = np.asarray(errors.columns, dtype=np.float64)
        axis.axhspan(*ARTICLE_DETECTION_PX, **style.ARTICLE_BAND, label="article's detection noise")
        for fixation, colour, line in (
            ("still", style.BLUE, "o-"),
            ("dithered", style.GREEN, "^--"),
        ):
            axis.plot(frames, errors.loc[(depth, fixation)], line, color=colour,
                      label=f"{fixation} fixation")  # fmt: skip
        for name, colour, dash in (("window", style.PURPLE, "-."), ("board", style.GREY, "-")):
            axis.plot(frames, bound.loc[depth, name] / np.sqrt(frames), color=colour,
                      linestyle=dash, label=f"Cramér-Rao bound, {name}")  # fmt: skip
        axis.set(title=f"{depth / 1000.0:g} m", xlabel="frames averaged")
        style.log_axis(axis, "x")
        style.log_axis(axis)
    axes[0].set_ylabel("root mean square error (px)")
    style.legend_below(figure, 3)
    return figure


EXPERIMENT: Final = Experiment(
    name=NAME, title="Uncertainty", article="Section 4, Eqs. 25 to 36",
    text=read_template(__package__, "sections/uncertainty.jinja"), config=UncertaintyConfig,
    quick={
        "draws": 200, "point_step": 10, "gains": (1.0, 4.0), "heads": 40, "loop_samples": 600,
        "image_gains": (4.0,), "image_samples": 900, "reach_draws": 100,
        "averaging_depths_m": (1.5, 2.5), "frames": 256, "replicates": 6,
    },
    run=run, summarise=summarise, numbers=numbers, draw=draw,
)  # fmt: skip
