"""The physical time response: settling time of a gaze shift from the article's initial pixels."""

from dataclasses import dataclass
from functools import partial
from typing import Final, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm
from matplotlib.figure import Figure
from scipy.optimize import root

from vergence.envs.targets.prescribed import StaticTarget
from vergence.errors import ConfigurationError
from vergence.eval.article.closed_loop import servo_pixel_errors, with_joint_offsets
from vergence.eval.article.experiment import Experiment, SummaryRow, rows_where
from vergence.eval.trials.metrics import settle_time
from vergence.models.head import HeadModel
from vergence.models.head_file import load_head
from vergence.models.parts import EYE_NAMES, EYES, JOINTS, LINKS, FloatArray
from vergence.reporting import style
from vergence.reporting.jobs import Job, Mapper
from vergence.reporting.text import Numbers, read_template

ARTICLE_S: Final = 0.65
"""Settling time of a gaze shift, s (physical: reported by the article)."""
_EYE_FRAMES: Final = [3, 4, 6, 7]
"""Rows of `LINKS` with the eyes' joints, in joint order (numerical)."""


@dataclass(frozen=True, kw_only=True)
class TimeResponseConfig:
    """Configuration of the time response."""

    head: str = "physical"
    """Head, one of the article's: simulated or physical."""
    point_mm: tuple[float, float, float] = (0.0, -145.0, 1500.0)
    """Target position, in N, mm."""
    left_px: tuple[float, float] = (385.98, 196.60)
    """Initial pixel of the target in the left eye, px."""
    right_px: tuple[float, float] = (361.09, 191.82)
    """Initial pixel of the target in the right eye, px."""
    gain: float = 4.0
    """Gain k1 = k2, 1/s."""
    delays_frames: tuple[int, ...] = tuple(range(13))
    """Image delays of the map, control periods."""
    least_threshold_px: float = 0.25
    """Smallest settling threshold of the map, px."""
    greatest_threshold_px: float = 5.0
    """Largest settling threshold of the map, px."""
    threshold_step_px: float = 0.05
    """Increment of the threshold, px."""
    trials: int = 200
    """Number of trials with the preset's own delay, lag and noise."""
    duration_s: float = 3.0
    """Duration of a trial, s."""


def run(config: TimeResponseConfig, seed: int, mapper: Mapper) -> pd.DataFrame:
    """Run all trials.

    The table's `case` is `offset` (a joint offset that explains the initial pixels), `initial` (a
    pixel coordinate by the article and by the nominal head), `map` (settling time for a delay, lag
    and threshold, without noise), `by` (least threshold within which the error stays from the
    article's time on), `rig` (a noisy trial of the preset's own loop) or `trace` (error of one such
    trial over time).
    """
    head = load_head(config.head)
    offsets = joint_offsets(head, config)
    lags = tuple(dict.fromkeys((head.timing.lag_s, 0.0)))
    jobs: list[Job] = [
        partial(_map_delay, config, offsets, delay, lag)
        for lag in lags
        for delay in config.delays_frames
    ]
    jobs.append(partial(_rig, config, offsets, seed))
    parts: list[pd.DataFrame] = [_start(head, config, offsets), *mapper(jobs)]
    return pd.concat(parts, ignore_index=True)


def joint_offsets(head: HeadModel, config: TimeResponseConfig) -> tuple[float, ...]:
    """(4,) offsets of the eyes' joints that explain the article's initial pixels, rad.

    Four pixel coordinates determine four offsets. Other model errors could explain the pixels too.
    """
    point = np.array(config.point_mm) / 1000.0
    wanted = np.array([config.left_px, config.right_px])

    def miss(offsets: FloatArray) -> FloatArray:
        q = head.rest()
        q[EYES] += offsets
        return np.ravel(head.project(q, point) - wanted)

    found = root(miss, np.zeros(4), tol=1e-12)
    if not np.abs(miss(found.x)).max() < 1e-6:
        raise ConfigurationError(
            f"time-response: expected pixels at which the eyes can see {config.point_mm} mm, "
            f"got {config.left_px} and {config.right_px}"
        )
    return tuple(float(offset) for offset in found.x)


def _start(head: HeadModel, config: TimeResponseConfig, offsets: tuple[float, ...]) -> pd.DataFrame:
    """Table rows with the offsets, and with the initial pixels beside those of the nominal head."""
    joints = {"case": "offset", "joint": JOINTS[EYES], "offset_deg": np.rad2deg(offsets)}
    nominal = head.project(head.rest(), np.array(config.point_mm) / 1000.0)
    pixels = {
        "case": "initial", "eye": np.repeat(EYE_NAMES, 2), "axis": ["u", "v"] * 2,
        "article_px": [*config.left_px, *config.right_px], "nominal_px": nominal.ravel(),
        "principal_px": head.cameras.principal.ravel(),
    }  # fmt: skip
    return pd.concat([pd.DataFrame(joints), pd.DataFrame(pixels)], ignore_index=True)


def _servo(
    config: TimeResponseConfig, head: HeadModel, offsets: tuple[float, ...], seed: int, num: int,
    noise_px: float,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    x, y, z = (value / 1000.0 for value in config.point_mm)
    added = np.zeros(len(LINKS))
    added[_EYE_FRAMES] = offsets
    options = {"true_head": with_joint_offsets(head, added), "detection_noise_px": noise_px}
    return servo_pixel_errors(
        head, StaticTarget(point=(x, y, z)), np.full((num, 2), config.gain),
        duration_s=config.duration_s, seed=seed, plant_options=options,
    )  # fmt: skip


def _map_delay(
    config: TimeResponseConfig, offsets: tuple[float, ...], delay_frames: int, lag_s: float
) -> pd.DataFrame:
    """Settling times of one loop, and its least threshold that holds from the article's time on."""
    preset = load_head(config.head)
    latency_s = delay_frames / preset.timing.control_rate_hz
    head = preset.replace(timing={"latency_s": latency_s, "lag_s": lag_s})
    time, error = _servo(config, head, offsets, 0, 1, 0.0)
    low, step = config.least_threshold_px, config.threshold_step_px
    count = round((config.greatest_threshold_px - low) / step) + 1
    thresholds = np.round(low + step * np.arange(count), 9)
    settled = [float(settle_time(time, error, band)[0]) for band in thresholds]
    loop = {"delay_frames": delay_frames, "lag_s": lag_s}
    mapped = pd.DataFrame({"case": "map", **loop, "threshold_px": thresholds, "settle_s": settled})
    norm = np.linalg.norm(error[:, 0], axis=-1).max(axis=-1)
    # tolerance, as the article's time is a whole number of periods only up to rounding
    held = norm[time >= ARTICLE_S - 1e-9].max()
    by = pd.DataFrame([{"case": "by", **loop, "threshold_px": float(held), "settle_s": ARTICLE_S}])
    return pd.concat([mapped, by], ignore_index=True)


def _rig(config: TimeResponseConfig, offsets: tuple[float, ...], seed: int) -> pd.DataFrame:
    """Run noisy trials of the preset's own loop, and keep the error of the first over time."""
    head = load_head(config.head)
    timing = head.timing
    noise_px = head.sensor.detection_noise_px
    time, error = _servo(config, head, offsets, seed, config.trials, noise_px)
    loop = {"delay_frames": timing.latency_frames, "lag_s": timing.lag_s}
    parts = []
    for band in (1.0, 0.5):
        trials = {"case": "rig", **loop, "threshold_px": band, "trial": np.arange(config.trials)}
        parts.append(pd.DataFrame({**trials, "settle_s": settle_time(time, error, band)}))
    for eye, name in enumerate(EYE_NAMES):
        norm = np.linalg.norm(error[:, 0, eye], axis=-1)
        course = {"case": "trace", **loop, "trial": 0, "eye": name, "time_s": time}
        parts.append(pd.DataFrame({**course, "error_px": norm}))
    return pd.concat(parts, ignore_index=True)


NAME: Final = "time response"
_row = partial(SummaryRow.of, NAME)
PAIRS: Final = ((0, False, 3.0), (4, True, 1.3))
"""Loops that should give the article's time: image delay (control periods), true for the head's own
lag and false for none, settling threshold (px)."""


class LoopAndThreshold(NamedTuple):
    """A loop and a settling threshold that should give the article's time."""

    delay_frames: int
    lag_s: float
    threshold_px: float
    settle_s: float
    """Settling time of this loop in the map, s; nan if the map lacks it."""


class TimeResponseFindings(NamedTuple):
    """Results used by the figures, the summary and the text."""

    delay_frames: int
    """The head's own image delay, control periods."""
    lag_s: float
    """The head's own lag, s."""
    settle_s: dict[float, tuple[float, float]]
    """Least and greatest settling time of the noisy trials, s, by threshold in px; nan if some
    trial does not settle."""
    trials: int
    pairs: list[LoopAndThreshold]
    offsets_deg: dict[str, float]
    """Offset of each eye joint, degrees."""
    nominal_difference_px: tuple[float, float]
    """Least and greatest absolute difference, by coordinate, of the nominal initial pixels from
    the article's, px."""
    step_px: tuple[float, float]
    """Initial pixel error of the left and the right eye, px."""


def derive_findings(table: pd.DataFrame) -> TimeResponseFindings:
    """Derive the results from the table."""
    rig, offsets, initial, trace = (
        rows_where(table, case=case) for case in ("rig", "offset", "initial", "trace")
    )
    delay, lag = int(rig["delay_frames"].iloc[0]), float(rig["lag_s"].iloc[0])
    settle = {
        float(str(band)): (float(times.to_numpy().min()), float(times.to_numpy().max()))
        for band, times in rig.groupby("threshold_px")["settle_s"]
    }
    miss = np.abs((initial["article_px"] - initial["nominal_px"]).to_numpy())
    first = rows_where(trace, time_s=0.0)["error_px"].to_numpy()
    return TimeResponseFindings(
        delay, lag, settle, int(rig["trial"].nunique()),
        [_pair(table, frames, lag if lagging else 0.0, band) for frames, lagging, band in PAIRS],
        dict(zip(offsets["joint"], offsets["offset_deg"], strict=True)),
        (float(miss.min()), float(miss.max())), (float(first[0]), float(first[1])),
    )  # fmt: skip


def settle_time_map(table: pd.DataFrame, lag_s: float) -> pd.DataFrame:
    """Map of one lag: settling time in s, a row per threshold, a column per delay."""
    rows = rows_where(table, case="map", lag_s=lag_s)
    return rows.pivot_table(
        index="threshold_px", columns="delay_frames", values="settle_s", dropna=False
    )


def held_thresholds_px(table: pd.DataFrame, lag_s: float) -> pd.DataFrame:
    """Least threshold within which the error stays from the article's time on, by delay."""
    rows = rows_where(table, case="by", lag_s=lag_s)
    return rows.sort_values("delay_frames")


def _pair(table: pd.DataFrame, delay: int, lag_s: float, threshold_px: float) -> LoopAndThreshold:
    rows = rows_where(table, case="map", lag_s=lag_s)
    near = (rows["threshold_px"] - threshold_px).abs() < 1e-6
    settle = rows.loc[near & (rows["delay_frames"] == delay), "settle_s"]
    return LoopAndThreshold(delay, lag_s, threshold_px, settle.iloc[0] if len(settle) else np.nan)


def summarise(table: pd.DataFrame, config: TimeResponseConfig) -> list[SummaryRow]:
    """Rows of the summary: our settling times beside the article's 650 ms, and joint offsets."""
    del config
    found = derive_findings(table)
    article = 1000.0 * ARTICLE_S
    rows = []
    for band, (low_s, high_s) in sorted(found.settle_s.items(), reverse=True):
        ours = (1000.0 * low_s, 1000.0 * high_s)
        what = f"settle time to {band:g} px"
        rows.append(_row(what, "ibvs", "both eyes", article, ours, unit="ms"))
    for pair in found.pairs:
        what = (
            f"settle time to {pair.threshold_px:g} px with {pair.delay_frames} frames of delay and "
            f"{1000.0 * pair.lag_s:g} ms of lag"
        )
        settle = 1000.0 * pair.settle_s
        rows.append(_row(what, "ibvs", "both eyes", article, settle, unit="ms"))
    for joint, offset in found.offsets_deg.items():
        rows.append(_row("joint offset", "ibvs", joint, None, offset, unit="deg"))
    return rows


def numbers(table: pd.DataFrame, config: TimeResponseConfig) -> Numbers:
    """The numbers of the text."""
    found = derive_findings(table)
    without, with_delay = found.pairs
    (low_1, high_1), (low_05, high_05) = found.settle_s[1.0], found.settle_s[0.5]
    return {
        "article_ms": 1000.0 * ARTICLE_S,
        "trials": found.trials,
        "delay_frames": found.delay_frames,
        "lag_ms": 1000.0 * found.lag_s,
        "latency_ms": 1000.0 * found.delay_frames * load_head(config.head).timing.period_s,
        "settle_1px_low_ms": 1000.0 * low_1,
        "settle_1px_high_ms": 1000.0 * high_1,
        "settle_05px_low_ms": 1000.0 * low_05,
        "settle_05px_high_ms": 1000.0 * high_05,
        "without_delay_threshold_px": without.threshold_px,
        "without_delay_settle_ms": 1000.0 * without.settle_s,
        "with_delay_frames": with_delay.delay_frames,
        "with_delay_threshold_px": with_delay.threshold_px,
        "with_delay_settle_ms": 1000.0 * with_delay.settle_s,
        "miss_low_px": found.nominal_difference_px[0],
        "miss_high_px": found.nominal_difference_px[1],
        "step_left_px": found.step_px[0],
        "step_right_px": found.step_px[1],
        **{f"{joint}_deg": offset for joint, offset in found.offsets_deg.items()},
    }


def draw(table: pd.DataFrame, config: TimeResponseConfig) -> dict[str, Figure]:
    """All figures by name."""
    found = derive_findings(table)
    return {
        "time-response-error": _draw_trace(table, found),
        "time-response-map": _draw_map(table, config, found),
    }


def _draw_trace(table: pd.DataFrame, found: TimeResponseFindings) -> Figure:
    trace = rows_where(table, case="trace")
    figure = style.new_figure(6.4, 4.4)
    axes = figure.subplots()
    for eye, colour, dash in (("left", style.BLUE, "-"), ("right", style.ORANGE, "--")):
        rows = rows_where(trace, eye=eye)
        axes.plot(1000.0 * rows["time_s"], rows["error_px"], color=colour, linestyle=dash,
                  label=f"{eye} eye")  # fmt: skip
    ends = 0.0
    for band, (_, latest) in found.settle_s.items():
        axes.axhline(band, color=style.GREY, linewidth=1.0)
        if np.isfinite(latest):
            ends = max(ends, latest)
            axes.plot(1000.0 * latest, band, "o", color=style.BLACK, mfc="white")
            axes.annotate(
                f"{band:g} px: {1000.0 * latest:.0f} ms", (1000.0 * latest, band),
                (-6, -5), textcoords="offset points", ha="right", va="top",
            )  # fmt: skip
    axes.axvline(1000.0 * ARTICLE_S, **style.ARTICLE_STYLE)
    axes.annotate(
        f"article:\n{1000.0 * ARTICLE_S:.0f} ms", (1000.0 * ARTICLE_S, 0.95), (6, 0),
        xycoords=("data", "axes fraction"), textcoords="offset points", va="top",
    )  # fmt: skip
    axes.set(
        xlabel="time since the target appeared (ms)", ylabel="true pixel error (px)",
        title=f"Our rig: {found.delay_frames} frames, {1000.0 * found.lag_s:g} ms",
        xlim=(0.0, 1000.0 * max(0.9, 1.2 * ends)), ylim=(0.02, 80.0),
    )  # fmt: skip
    style.log_axis(axes)
    style.legend_below(figure, 2)
    return figure


def _draw_map(
    table: pd.DataFrame, config: TimeResponseConfig, found: TimeResponseFindings
) -> Figure:
    lags = list(dict.fromkeys((found.lag_s, 0.0)))
    edges = np.arange(0.35, 1.26, 0.1)
    figure = style.new_figure(9.0, 4.6)
    panels = figure.subplots(1, len(lags), sharex=True, sharey=True, squeeze=False)[0]
    for axes, lag_s in zip(panels, lags, strict=True):
        grid = settle_time_map(table, lag_s)
        filled = axes.pcolormesh(
            grid.columns, grid.index, grid.to_numpy(), shading="nearest", cmap="cividis",
            norm=BoundaryNorm(edges, 256, extend="both"), rasterized=True,
        )  # fmt: skip
        by = held_thresholds_px(table, lag_s)
        axes.plot(
            by["delay_frames"], by["threshold_px"], color="white", linewidth=2.4,
            label=f"settled by {1000.0 * ARTICLE_S:.0f} ms above",
        )  # fmt: skip
        _mark(axes, found, lag_s)
        name = f"lag {1000.0 * lag_s:g} ms" if lag_s else "no lag"
        axes.set(title=name, xlabel="image delay (frames)")
        axes.set_ylim(config.least_threshold_px, config.greatest_threshold_px)
        axes.grid(visible=False)
        dark = {"frameon": True, "facecolor": "#555555", "labelcolor": "white"}
        style.legend_below(axes, 1, fontsize=10, **dark)
    panels[0].set_ylabel("settle threshold (px)")
    bar = figure.colorbar(filled, ax=list(panels), label="settle time (s)", pad=0.02)
    bar.ax.axhline(ARTICLE_S, color="white", linewidth=2.4)
    return figure


def _mark(axes: Axes, found: TimeResponseFindings, lag_s: float) -> None:
    """Mark the pairs of delay and threshold that should give the article's time, and our rig."""
    for pair in found.pairs:
        if pair.lag_s == lag_s and np.isfinite(pair.settle_s):
            axes.plot(
                pair.delay_frames, pair.threshold_px, "^", color="white", mec="black",
                markersize=10, clip_on=False, zorder=5, linestyle="none",
                label=f"{pair.delay_frames} frames, {pair.threshold_px:g} px: "
                f"{1000.0 * pair.settle_s:.0f} ms",
            )  # fmt: skip
    if lag_s == found.lag_s:
        _, latest = found.settle_s[1.0]
        axes.plot(
            found.delay_frames, 1.0, "D", color="white", mec="black", markersize=9, zorder=5,
            linestyle="none", label=f"our rig, 1 px: {1000.0 * latest:.0f} ms",
        )  # fmt: skip


EXPERIMENT: Final = Experiment(
    name="time-response", title="Physical time response",
    article="Section 5.3.2",
    text=read_template(__package__, "sections/time_response.jinja"), config=TimeResponseConfig,
    quick={"trials": 20, "delays_frames": (0, 2, 4, 6, 8, 10, 12)},
    run=run, summarise=summarise, numbers=numbers, draw=draw,
)  # fmt: skip
