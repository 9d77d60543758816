r"""The gain sweep (Fig. 15): settling time and overshoot of a step, and the implied loop delay.

The delay and lag of a loop follow from the gain at which overshoot begins. The linear loop with a
pure delay D, a velocity lag of time constant T and the gain k,

    s + k exp(-s D) / (1 + s T) = 0,

does not overshoot as long as its two slowest roots are real. They meet at s = -x with

    D T x^2 - (2 T + D) x + 1 = 0,    k = x (1 - x T) exp(-x D),

so that k = 1 / (e D) without a lag and k = 1 / (4 T) without a delay.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from math import exp, sqrt
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from vergence.envs.targets.prescribed import StepTarget
from vergence.eval.article.closed_loop import servo_pixel_errors
from vergence.eval.article.criterion import BY_CONSTRUCTION, NO_FIGURE
from vergence.eval.article.experiment import Experiment, SummaryRow, rows_where
from vergence.eval.trials.metrics import overshoot_fraction, settle_time
from vergence.models.head_file import load_head
from vergence.models.parts import FloatArray, LoopTiming
from vergence.reporting import style
from vergence.reporting.jobs import Job, Mapper
from vergence.reporting.text import Numbers, read_template


def critical_gain(delay_s: float, lag_s: float) -> float:
    """Greatest gain without overshoot for a pure delay and a lag, not both 0, 1/s."""
    middle = 2.0 * lag_s + delay_s
    # smaller root of the quadratic, in a form that also holds if delay or lag is 0
    x = 2.0 / (middle + sqrt(middle**2 - 4.0 * delay_s * lag_s))
    return x * (1.0 - x * lag_s) * exp(-x * delay_s)


def critical_lag(delay_s: float, gain: float) -> float:
    """Lag that with this delay gives a critical gain, s; nan if the delay alone is too long."""
    if delay_s > 0.0 and critical_gain(delay_s, 0.0) < gain:
        return float("nan")
    longest = 1.0 / (4.0 * gain)  # the lag without a delay
    if delay_s == 0.0:
        return longest
    return float(brentq(lambda lag: critical_gain(delay_s, lag) - gain, 0.0, longest, xtol=1e-9))


def first_crossing(at: ArrayLike, values: ArrayLike, level: float) -> float:
    """Argument at which samples first rise above a level, interpolated; nan if they never do."""
    x: FloatArray = np.asarray(at, dtype=np.float64)
    y: FloatArray = np.asarray(values, dtype=np.float64)
    above = y > level
    if not above.any() or above[0]:
        return float("nan")
    i = int(np.argmax(above))
    part = (level - y[i - 1]) / (y[i] - y[i - 1])
    return float(x[i - 1] + part * (x[i] - x[i - 1]))


STEPS: Final = {"+y": (0.0, 1.0), "-y": (0.0, -1.0), "+x": (1.0, 0.0), "-x": (-1.0, 0.0)}
"""Directions of the step, in N; y is down."""
PLANE_STEPS: Final = {"+y": (0.0, 1.0), "+x+y": (1.0, 1.0)}
"""Steps on which k1 and k2 are varied independently."""
_TRIALS: Final = 10_000
"""Trial numbers reserved per job, so that jobs share no noise (numerical)."""


@dataclass(frozen=True, kw_only=True)
class GainSweepConfig:
    """Configuration of the gain sweep."""

    head: str = "simulated"
    """Head, one of the article's: simulated or physical."""
    point_mm: tuple[float, float, float] = (0.0, -100.0, 1000.0)
    """Position of the target before the step, in N, mm."""
    step_mm: float = 100.0
    """Length of the target's jump along an axis, mm."""
    least_gain: float = 0.5
    """Smallest gain of the sweep with k1 = k2, 1/s."""
    greatest_gain: float = 6.0
    """Largest gain of the sweep, 1/s."""
    gain_step: float = 0.05
    """Increment of the gain, 1/s."""
    plane_step: float = 0.25
    """Increment of the gains for the plane of k1 and k2, 1/s."""
    mujoco_gains: tuple[float, ...] = (0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    """Gains at which the sweep also runs on the mujoco plant, 1/s."""
    duration_s: float = 12.0
    """Duration of a trial, s; the smallest gain needs 10 s to settle to 0.5 px."""
    onset_fraction: float = 0.005
    """Overshoot, as a fraction of the step, from which it counts as begun."""
    onset_gains: tuple[float, float] = (4.0, 4.2)
    """Gains between which the article's overshoot is assumed to begin, 1/s."""
    delays_frames: tuple[int, ...] = tuple(range(14))
    """Image delays tried to identify the loop, control periods."""
    lag_step_s: float = 0.002
    """Increment of the lags tried to identify the loop, s."""
    greatest_lag_s: float = 0.1
    """Longest lag tried to identify the loop, s."""


def run(config: GainSweepConfig, seed: int, mapper: Mapper) -> pd.DataFrame:
    """A row per trial. `case` is `sweep` (k1 = k2), `plane` (k1 and k2 independent) or `loop`.

    Those of `loop` are without noise, at other delays and lags; `overshoot` is a fraction of the
    step.
    """
    plane = _grid(config.least_gain, config.greatest_gain, config.plane_step)
    pairs = [(k1, k2) for k1 in plane for k2 in plane]
    both = [(k, k) for k in _grid(config.least_gain, config.greatest_gain, config.gain_step)]
    few = [(k, k) for k in config.mujoco_gains]
    cases = [("sweep", "kinematic", step, both) for step in STEPS]
    cases += [("plane", "kinematic", step, pairs) for step in PLANE_STEPS]
    cases += [("sweep", "mujoco", step, few) for step in STEPS]
    jobs: list[Job] = [
        partial(_steps, config, seed, index * _TRIALS, *case) for index, case in enumerate(cases)
    ]
    jobs += [partial(_loops, config, delay) for delay in config.delays_frames]
    tables: list[pd.DataFrame] = mapper(jobs)
    return pd.concat(tables, ignore_index=True)


def _grid(least: float, greatest: float, step: float) -> list[float]:
    return [round(least + i * step, 9) for i in range(round((greatest - least) / step) + 1)]


def _steps(
    config: GainSweepConfig, seed: int, first_trial: int, case: str, plant: str, step: str,
    gains: Sequence[tuple[float, float]],
) -> pd.DataFrame:  # fmt: skip
    """Run trials of one step with the preset's own delay and lag."""
    head = load_head(config.head)
    time, error = servo_pixel_errors(
        head, _target(config, step), gains, duration_s=config.duration_s, seed=seed,
        first_trial=first_trial, plant=plant,
        plant_options={"nthread": 1} if plant == "mujoco" else {},
    )  # fmt: skip
    timing = head.timing
    return _rows(case, plant, step, gains, timing.latency_frames, timing.lag_s, time, error)


def _loops(config: GainSweepConfig, delay_frames: int) -> pd.DataFrame:
    """Run trials with one image delay and many lags, at the config's onset gains."""
    lags = _grid(0.0, config.greatest_lag_s, config.lag_step_s)
    gains = [(gain, gain) for gain in config.onset_gains for _ in lags]
    lag_s = np.tile(lags, len(config.onset_gains))
    preset = load_head(config.head)
    latency_s = delay_frames / preset.timing.control_rate_hz
    time, error = servo_pixel_errors(
        preset.replace(timing={"latency_s": latency_s}), _target(config, "-y"), gains,
        duration_s=min(config.duration_s, 3.0), seed=0,
        plant_options={"lag_s": lag_s, "detection_noise_px": 0.0},
    )  # fmt: skip
    return _rows("loop", "kinematic", "-y", gains, delay_frames, lag_s, time, error)


def _target(config: GainSweepConfig, step: str) -> StepTarget:
    dx, dy = {**STEPS, **PLANE_STEPS}[step]
    x, y, z = config.point_mm
    after = ((x + config.step_mm * dx) / 1000.0, (y + config.step_mm * dy) / 1000.0, z / 1000.0)
    return StepTarget(before=(x / 1000.0, y / 1000.0, z / 1000.0), after=after)


def _rows(
    case: str, plant: str, step: str, gains: Sequence[tuple[float, float]], delay_frames: int,
    lag_s: float | FloatArray, time: FloatArray, error: FloatArray,
) -> pd.DataFrame:  # fmt: skip
    k1, k2 = np.array(gains).T
    return pd.DataFrame({
        "case": case, "plant": plant, "step": step, "k1_per_s": k1, "k2_per_s": k2,
        "delay_frames": delay_frames, "lag_s": lag_s,
        "step_px": np.linalg.norm(error[0], axis=-1).max(axis=-1),
        "settle_1px_s": settle_time(time, error, 1.0),
        "settle_05px_s": settle_time(time, error, 0.5),
        "overshoot": overshoot_fraction(error),
    })  # fmt: skip


NAME: Final = "gain sweep"
_row = partial(SummaryRow.of, NAME)
ARTICLE_GAIN: Final = 4.0
"""Gain above which the article's system overshot, 1/s (physical: reported by the article)."""


class LoopFamily(NamedTuple):
    """Loops, by image delay and lag, whose overshoot begins at one gain."""

    gain: float
    """Gain at which overshoot begins, 1/s."""
    delays_frames: FloatArray
    """(n,) image delays, control periods."""
    lags_s: FloatArray
    """(n,) lag of the loop with each delay, s; nan if the delay alone is too long."""
    longest_delay_frames: float
    """Image delay of the loop without a lag, control periods; nan if beyond those tried."""

    def delay_frames_at_lag(self, lag_s: float) -> float:
        """Image delay of the loop with a lag, control periods; nan if beyond those tried."""
        lags = np.where(np.isnan(self.lags_s), -1.0, self.lags_s)
        return first_crossing(self.delays_frames, -lags, -lag_s)


def sweep_trials(table: pd.DataFrame, step: str, plant: str = "kinematic") -> pd.DataFrame:
    """Trials of one step with k1 = k2, sorted by gain."""
    return rows_where(table, case="sweep", step=step, plant=plant).sort_values("k1_per_s")


def trial_at_gain(rows: pd.DataFrame, gain: float) -> "pd.Series[Any]":
    """The trial whose k2 is nearest to the wanted gain."""
    return rows.iloc[int(np.argmin(np.abs(rows["k2_per_s"].to_numpy() - gain)))]


def fastest_trial(rows: pd.DataFrame) -> "pd.Series[Any]":
    """The trial with the shortest settling time to 1 px."""
    return rows.iloc[int(np.nanargmin(rows["settle_1px_s"].to_numpy()))]


def loop_family(table: pd.DataFrame, config: GainSweepConfig, gain: float) -> LoopFamily:
    """Loops whose overshoot begins at one of the config's onset gains."""
    loops = rows_where(table, case="loop", k1_per_s=gain)
    lags = [
        first_crossing(rows["lag_s"], rows["overshoot"], config.onset_fraction)
        for _, rows in loops.groupby("delay_frames")
    ]
    without = rows_where(loops, lag_s=0.0).sort_values("delay_frames")
    delays = without["delay_frames"].to_numpy(dtype=np.float64)
    longest = first_crossing(delays, without["overshoot"], config.onset_fraction)
    return LoopFamily(gain, delays, np.array(lags), longest)


class GainSweepFindings(NamedTuple):
    """Results used by the figures, the summary and the text."""

    onset_gain_by_step: dict[str, float]
    """Gain at which overshoot begins, by step, 1/s; nan if it does not begin in the sweep."""
    families: list[LoopFamily]
    timing: LoopTiming
    """That of the head, with its own delay and lag."""
    plants_settle_difference_s: float
    """Largest difference of settling times to 1 px between the kinematic and mujoco plants, s."""
    plants_overshoot_difference: float
    """Largest difference of overshoots between these plants, as a fraction of the step."""
    directions_settle_difference_s: float
    """Largest difference of settling times to 1 px between the steps along +y and -y, s."""

    @property
    def delays_frames(self) -> list[float]:
        """Image delay of each family for the head's own lag, control periods."""
        return [family.delay_frames_at_lag(self.timing.lag_s) for family in self.families]


def derive_findings(table: pd.DataFrame, config: GainSweepConfig) -> GainSweepFindings:
    """Derive the results from the table."""
    settle, beyond, onsets = [0.0], [0.0], {}
    for step in STEPS:
        rows = sweep_trials(table, step)
        onsets[step] = first_crossing(rows["k1_per_s"], rows["overshoot"], config.onset_fraction)
        both = rows.merge(sweep_trials(table, step, "mujoco"), on="k1_per_s")
        for column, apart in (("settle_1px_s", settle), ("overshoot", beyond)):
            apart.extend((both[f"{column}_x"] - both[f"{column}_y"]).abs())
    down, up = (sweep_trials(table, step)["settle_1px_s"].to_numpy() for step in ("+y", "-y"))
    families = [loop_family(table, config, gain) for gain in config.onset_gains]
    return GainSweepFindings(
        onsets, families, load_head(config.head).timing,
        _greatest(settle), _greatest(beyond), _greatest(np.abs(down - up)),
    )  # fmt: skip


def _greatest(values: ArrayLike) -> float:
    """Largest finite value; nan if there is none."""
    known = np.asarray(values)
    known = known[np.isfinite(known)]
    return float(known.max()) if known.size else float("nan")


def numbers(table: pd.DataFrame, config: GainSweepConfig) -> Numbers:
    """The numbers of the text."""
    found, rows = derive_findings(table, config), sweep_trials(table, "-y")
    slow, reached, best = rows.iloc[0], trial_at_gain(rows, ARTICLE_GAIN), fastest_trial(rows)
    plane = rows_where(table, case="plane")
    plane = rows_where(plane, k2_per_s=trial_at_gain(plane, ARTICLE_GAIN)["k2_per_s"])
    onsets = list(found.onset_gain_by_step.values())
    filled: dict[str, float] = {
        "article_gain": ARTICLE_GAIN,
        "least_gain": slow["k1_per_s"],
        "least_gain_settle_s": slow["settle_1px_s"],
        "article_gain_settle_s": reached["settle_1px_s"],
        "article_gain_settle_05px_s": reached["settle_05px_s"],
        "fastest_gain": best["k1_per_s"],
        "fastest_settle_s": best["settle_1px_s"],
        "fastest_overshoot_percent": 100.0 * best["overshoot"],
        "directions_apart_ms": 1000.0 * found.directions_settle_difference_s,
        "dynamics_apart_ms": 1000.0 * found.plants_settle_difference_s,
        "dynamics_overshoot_apart_percent": 100.0 * found.plants_overshoot_difference,
        "plane_k2": plane["k2_per_s"].iloc[0],
        "plane_k1_low": plane["k1_per_s"].min(),
        "plane_k1_high": plane["k1_per_s"].max(),
        "onset_percent": 100.0 * config.onset_fraction,
        "onset_low": float(np.min(onsets)),
        "onset_high": float(np.max(onsets)),
        "period_ms": 1000.0 * found.timing.period_s,
        "latency_frames": found.timing.latency_frames,
        "lag_ms": 1000.0 * found.timing.lag_s,
        "theory_delay_ms": 1000.0 / (np.e * ARTICLE_GAIN),
        "theory_lag_ms": 1000.0 / (4.0 * ARTICLE_GAIN),
    }
    for step, name in zip(PLANE_STEPS, ("y", "xy"), strict=True):
        settle = rows_where(plane, step=step)["settle_1px_s"]
        filled[f"plane_{name}_change_ms"] = 1000.0 * (settle.max() - settle.min())
    ends = zip(("low", "high"), found.families, found.delays_frames, strict=True)
    for end, family, frames in ends:
        filled[f"loops_{end}_gain"] = family.gain
        filled[f"loops_{end}_delay_ms"] = (
            1000.0 * found.timing.period_s * family.longest_delay_frames
        )
        filled[f"loops_{end}_lag_ms"] = 1000.0 * family.lags_s[0]
        filled[f"loops_{end}_frames"] = frames
    return {name: float(value) for name, value in filled.items()}


def summarise(table: pd.DataFrame, config: GainSweepConfig) -> list[SummaryRow]:
    """Rows of the summary: our figures beside the article's only one, and others of ours."""
    found = derive_findings(table, config)
    rows = []
    for axis, steps in (("y", ("+y", "-y")), ("x", ("+x", "-x"))):
        gains = [found.onset_gain_by_step[step] for step in steps]
        onset = (float(np.min(gains)), float(np.max(gains)))
        # the preset's image delay was chosen for an onset just above the article's gain
        verdict = BY_CONSTRUCTION if np.isfinite(onset).all() else None
        quantity = "gain at which overshoot begins"
        rows.append(_row(quantity, "ibvs", axis, ARTICLE_GAIN, onset, verdict, "1/s"))
        for gain in (sweep_trials(table, "+y")["k1_per_s"].min(), ARTICLE_GAIN):
            trials = [trial_at_gain(sweep_trials(table, step), gain) for step in steps]
            settled = [trial["settle_1px_s"] for trial in trials]
            ours, quantity = (min(settled), max(settled)), f"settle time to 1 px at k = {gain:g}"
            rows.append(_row(quantity, "ibvs", axis, None, ours, unit="s"))
    best = [float(fastest_trial(sweep_trials(table, step))["k1_per_s"]) for step in ("+y", "-y")]
    rows.append(_row("fastest gain", "ibvs", "y", None, (min(best), max(best)), unit="1/s"))
    low, high = float(np.min(found.delays_frames)), float(np.max(found.delays_frames))
    period_ms = 1000.0 * found.timing.period_s
    quantity = f"image delay identified with a lag of {1000.0 * found.timing.lag_s:g} ms"
    verdict = "inside" if low <= found.timing.latency_frames <= high else "outside"
    verdict = verdict if np.isfinite([low, high]).all() else NO_FIGURE
    ours = (period_ms * low, period_ms * high)
    rows.append(_row(quantity, "ibvs", "y", None, ours, verdict, "ms"))
    up_to = sweep_trials(table, "-y").query("k1_per_s <= @ARTICLE_GAIN + 1e-9")["settle_1px_s"]
    rise = float(up_to.diff().max())
    quantity = f"greatest rise of the settle time from gain to gain up to k = {ARTICLE_GAIN:g}"
    verdict = "target met" if rise <= 0.0 else "target missed"
    return [*rows, _row(f"{quantity}, target 0 s", "ibvs", "y", None, rise, verdict, "s")]


_STEP_STYLE: Final[dict[str, dict[str, Any]]] = {
    "+y": {"color": style.BLUE, "linestyle": "-", "linewidth": 3.2, "alpha": 0.55},
    "-y": {"color": style.BLACK, "linestyle": "--"},
    "+x": {"color": style.ORANGE, "linestyle": ":"},
}
"""Line styles: both directions of the article's axis, and one along x, on which k1 acts."""


def draw(table: pd.DataFrame, config: GainSweepConfig) -> dict[str, Figure]:
    """All figures by name."""
    found = derive_findings(table, config)
    return {
        "fig15-gain-sweep": _draw_sweep(table, config),
        "fig15-gain-plane": _draw_plane(table),
        "fig15-loop-delay": _draw_loops(found, config),
    }


def _draw_sweep(table: pd.DataFrame, config: GainSweepConfig) -> Figure:
    figure = style.new_figure(9.0, 4.3)
    left, right = figure.subplots(1, 2)
    for step, look in _STEP_STYLE.items():
        rows = sweep_trials(table, step)
        left.plot(rows["k1_per_s"], rows["settle_1px_s"], label=f"step along {step}", **look)
        right.plot(rows["k1_per_s"], 100.0 * rows["overshoot"], **look)
    rows = sweep_trials(table, "-y")
    ideal = np.log(rows["step_px"]) / rows["k1_per_s"]
    left.plot(rows["k1_per_s"], ideal, color=style.GREY, linewidth=1.2, label="ln(step / 1 px) / k")
    for axes, column, scale in ((left, "settle_1px_s", 1.0), (right, "overshoot", 100.0)):
        dots = sweep_trials(table, "-y", "mujoco")
        axes.plot(
            dots["k1_per_s"], scale * dots[column], "o", color=style.BLACK, mfc="white",
            label="with masses, -y",
        )  # fmt: skip
        axes.axvline(ARTICLE_GAIN, **style.ARTICLE_STYLE)
        axes.set(xlabel="gain $k_1 = k_2$ (1/s)", xlim=(0.0, config.greatest_gain + 0.2))
    left.set(ylabel="settle time to 1 px (s)", title="Settle time")
    style.log_axis(left)
    level = 100.0 * config.onset_fraction
    right.set(ylabel="overshoot (% of the step)", title="Overshoot")
    right.set_yscale("symlog", linthresh=0.1)
    right.set_ylim(-0.02, 20.0)
    right.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    right.axhline(level, color=style.GREY, linewidth=1.0)
    right.annotate(
        f"counts as begun: {level:g} %", (0.1, level), (2, 4), textcoords="offset points"
    )
    right.annotate(
        "article:\novershoot above 4", (ARTICLE_GAIN, 0.9), (-6, 0),
        xycoords=("data", "axes fraction"), textcoords="offset points", ha="right", va="top",
    )  # fmt: skip
    style.legend_below(figure, 5, fontsize=10)
    return figure


def _draw_plane(table: pd.DataFrame) -> Figure:
    titles = {"+y": "Step in y alone", "+x+y": "Step in x and y"}
    plane = rows_where(table, case="plane")
    low, high = plane["settle_1px_s"].min(), plane["settle_1px_s"].max()
    norm = LogNorm(low, high)
    figure = style.new_figure(9.0, 4.3)
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    for axes, step in zip(panels, PLANE_STEPS, strict=True):
        rows = rows_where(plane, step=step)
        grid = rows.pivot_table(index="k2_per_s", columns="k1_per_s", values="settle_1px_s")
        filled = axes.pcolormesh(
            grid.columns, grid.index, grid.to_numpy(), norm=norm, cmap="cividis",
            shading="nearest", rasterized=True,
        )  # fmt: skip
        lines = axes.contour(
            grid.columns, grid.index, grid.to_numpy(), levels=[0.8, 1.2, 2.0, 4.0],
            colors="white", linewidths=1.0,
        )  # fmt: skip
        axes.clabel(lines, fmt="%g s", fontsize=10)
        for mark in (axes.axvline, axes.axhline):
            mark(ARTICLE_GAIN, **{**style.ARTICLE_STYLE, "color": "white"})
        axes.set(title=titles[step], xlabel="$k_1$ (1/s)", aspect="equal")
        axes.grid(visible=False)
    panels[0].set_ylabel("$k_2$ (1/s)")
    bar = figure.colorbar(filled, ax=list(panels), label="settle time to 1 px (s)", pad=0.02)
    ticks = [tick for tick in (0.5, 1.0, 2.0, 4.0, 8.0) if low <= tick <= high]
    bar.minorticks_off()
    bar.set_ticks(ticks, labels=[f"{tick:g}" for tick in ticks])
    return figure


def _draw_loops(found: GainSweepFindings, config: GainSweepConfig) -> Figure:
    figure = style.new_figure(6.4, 4.6)
    axes = figure.subplots()
    level, timing = 100.0 * config.onset_fraction, found.timing
    for family, color, dash in zip(
        found.families, (style.BLUE, style.GREEN), ("-", "--"), strict=True
    ):
        delays = np.append(family.delays_frames, family.longest_delay_frames)
        known = np.isfinite(delays) & np.isfinite(lags := np.append(family.lags_s, 0.0))
        label = f"{level:g} % at k = {family.gain:g}"
        axes.plot(delays[known], 1000.0 * lags[known], color=color, linestyle=dash, label=label)
    axes.plot(
        timing.latency_frames, 1000.0 * timing.lag_s, "D", color=style.BLACK, markersize=9,
        label=f"our rig: {timing.latency_frames} frames, {1000.0 * timing.lag_s:g} ms",
    )  # fmt: skip
    delays = np.linspace(0.0, 14.0, 113) * timing.period_s
    hold = 0.5 * timing.period_s
    critical = [critical_lag(delay + hold, ARTICLE_GAIN) for delay in delays]
    axes.plot(
        delays / timing.period_s, 1000.0 * np.array(critical), **style.ARTICLE_STYLE,
        label=f"linear theory: none at all up to k = {ARTICLE_GAIN:g}",
    )  # fmt: skip
    axes.set(
        xlabel=f"image delay (frames of {1000.0 * timing.period_s:.3g} ms)",
        ylabel="lag of the joints (ms)",
        title="Loops whose overshoot begins where the article's does",
        xlim=(-0.2, None), ylim=(0.0, None),
    )  # fmt: skip
    style.legend_below(figure, 2, fontsize=10)
    return figure


EXPERIMENT: Final = Experiment(
    name="gain-sweep", title="Gain sweep",
    article="Section 5.3.1, Fig. 15",
    text=read_template(__package__, "sections/gain_sweep.jinja"), config=GainSweepConfig,
    quick={"gain_step": 0.25, "plane_step": 0.5, "lag_step_s": 0.005, "mujoco_gains": (1.0, 4.0)},
    run=run, summarise=summarise, numbers=numbers, draw=draw,
)  # fmt: skip
