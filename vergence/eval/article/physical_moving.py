"""The physical twin on a moving target: Figures 12 and 13."""

import dataclasses
from dataclasses import dataclass
from functools import partial
from typing import Final, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from vergence.envs.streams import IntArray
from vergence.envs.targets.prescribed import LineTarget
from vergence.eval.article import twin
from vergence.eval.article.closed_loop import MM, ClosedLoop, hold_gaze
from vergence.eval.article.experiment import Experiment, SummaryRow, rows_where
from vergence.eval.article.reported import ARTICLE_GAIN, ReportedResult, reported_result
from vergence.eval.article.twin import AXES, METHODS
from vergence.models.parts import FloatArray
from vergence.reporting import style
from vergence.reporting.jobs import Job, Mapper
from vergence.reporting.text import Numbers, read_template

_IMAGED_TRIAL: Final = 1_000_000
"""Trial number of the head with images, beyond those of the population (numerical)."""
_CHUNK: Final = 25
"""Heads per job, fixed so that results do not depend on the number of workers (numerical)."""


@dataclass(frozen=True, kw_only=True)
class PhysicalMovingConfig(twin.TwinConfig):
    """Configuration of the moving target on the physical twin."""

    origin_mm: tuple[float, float, float] = (-278.60, -23.13, 957.84)
    """Start of the recorded part of the line, in N, mm."""
    end_mm: tuple[float, float, float] = (-390.02, -30.39, 1111.91)
    """End of the line, in N, mm."""
    speed_m_s: float = 0.01
    """Speed of the target, m/s."""
    settle_s: float = 2.0
    """Time for which the target moves along the same line before the record begins, s."""
    every: int = 1
    """Control periods between fixes of the record."""
    table_every: int = 20
    """Fixes between rows of the trajectories in the table."""

    @property
    def velocity_mm_s(self) -> FloatArray:
        """(3,) velocity of the target, in N, mm/s."""
        way = np.array(self.end_mm) - np.array(self.origin_mm)
        return np.asarray(way * (MM * self.speed_m_s / np.linalg.norm(way)))

    @property
    def middle_mm(self) -> FloatArray:
        """(3,) midpoint of the recorded part of the line, in N, mm."""
        return np.asarray(0.5 * (np.array(self.origin_mm) + np.array(self.end_mm)))


class _Errors(NamedTuple):
    """Errors of the fixes on a moving target."""

    time_s: FloatArray
    """(samples,) time since the record began, s."""
    target: FloatArray
    """(samples, 3) target position at present, in N, mm."""
    errors: dict[str, FloatArray]
    """(samples, heads, 3) errors by method, mm."""


def run(config: PhysicalMovingConfig, seed: int, mapper: Mapper) -> pd.DataFrame:
    """Follow the line: the population, also with half its common tilt, and one head on images.

    The table's `case` is `twin` (one row), `head` (a row per head and method: mean absolute errors
    over the line), `time` (a row per instant and method: the head with images) or `band` (a row per
    instant, method and axis: percentiles of the population).
    """
    drawn = twin.draw_population(config, seed, mapper)
    loop = _loop(drawn, config, seed)
    errors = config.errors.scaled(drawn.scale)
    halved = dataclasses.replace(errors, common_tilt_rad=0.5 * errors.common_tilt_rad)
    firsts = range(0, config.heads, _CHUNK)
    jobs: list[Job] = [
        partial(_follow, loop.of_heads(group[first : first + _CHUNK], first))
        for group in (drawn.heads, twin.draw_heads(drawn.nominal, halved, config.heads, seed))
        for first in firsts
    ]
    imaged = drawn.heads[drawn.imaged_head : drawn.imaged_head + 1]
    jobs.append(partial(_follow, loop.of_heads(imaged, _IMAGED_TRIAL, images=True)))
    *parts, seen = mapper(jobs)
    population, half_tilt = _joined(parts[: len(firsts)]), _joined(parts[len(firsts) :])
    kept = slice(None, None, config.table_every)
    all_heads = np.arange(config.heads)
    frames: list[pd.DataFrame] = [
        drawn.table_row(), _head_rows("population", population, all_heads),
        _head_rows("half tilt", half_tilt, all_heads),
        _head_rows("imaged", seen, np.array([drawn.imaged_head])), _time_rows(seen, kept),
        _band_rows(population, kept),
    ]  # fmt: skip
    return pd.concat(frames, ignore_index=True)


def _loop(drawn: twin.TwinPopulation, config: PhysicalMovingConfig, seed: int) -> ClosedLoop:
    """Closed loop on the line, begun early so that the eyes follow when the record begins."""
    origin, end = np.array(config.origin_mm) / MM, np.array(config.end_mm) / MM
    length, speed = float(np.linalg.norm(end - origin)), config.speed_m_s
    early = origin - (end - origin) / length * speed * config.settle_s
    target = LineTarget(origin=tuple(early.tolist()), end=tuple(end.tolist()), speed=speed)
    periods = int(length / config.speed_m_s * drawn.nominal.timing.control_rate_hz)
    depth_m = 0.5 * (config.origin_mm[2] + config.end_mm[2]) / MM
    return ClosedLoop(
        head=drawn.nominal, target=target, samples=1 + periods // config.every,
        every=config.every, settle_s=config.settle_s, plant="kinematic",
        plant_options={"detection_noise_px": drawn.noise_at(depth_m)}, seed=seed,
    )  # fmt: skip


def _follow(loop: ClosedLoop) -> _Errors:
    record = hold_gaze(loop)
    errors = {"gaze": record.gaze_error_mm, "itpc": record.itpc_error_mm}
    return _Errors(record.time_s[:, 0] - loop.settle_s, MM * record.target[:, 0], errors)


def _joined(parts: list[_Errors]) -> _Errors:
    errors = {m: np.concatenate([part.errors[m] for part in parts], axis=1) for m in METHODS}
    return parts[0]._replace(errors=errors)


def _head_rows(group: str, seen: _Errors, heads: IntArray) -> pd.DataFrame:
    frames = []
    for method, error in seen.errors.items():
        by_axis = np.moveaxis(error, -1, 0)
        columns = twin.axis_columns(
            mean_abs=[np.nanmean(np.abs(own), axis=0) for own in by_axis],
            mean=[np.nanmean(own, axis=0) for own in by_axis],
            std=[np.nanstd(own, axis=0, ddof=1) for own in by_axis],
        )
        keys = {"case": "head", "group": group, "head": heads, "method": method}
        frames.append(pd.DataFrame({**keys, **columns}))
    return pd.concat(frames)


def _time_rows(seen: _Errors, kept: slice) -> pd.DataFrame:
    frames = []
    for method, error in seen.errors.items():
        keys = {"case": "time", "group": "imaged", "method": method, "time_s": seen.time_s[kept]}
        columns = twin.axis_columns(truth=seen.target[kept].T, error=error[kept, 0].T)
        frames.append(pd.DataFrame({**keys, **columns}))
    return pd.concat(frames)


def _band_rows(population: _Errors, kept: slice) -> pd.DataFrame:
    frames = []
    for method, error in population.errors.items():
        for k, axis in enumerate(AXES):
            low, median, high = np.percentile(np.abs(error[kept, :, k]), [10.0, 50.0, 90.0], axis=1)
            rows = pd.DataFrame({
                "case": "band", "group": "population", "method": method, "axis": axis,
                "time_s": population.time_s[kept], "low_mm": low, "median_mm": median,
                "high_mm": high,
            })  # fmt: skip
            frames.append(rows)
    return pd.concat(frames)


NAME: Final = "physical moving"
_row = partial(SummaryRow.of, NAME)
_MIDDLE: Final = ", middle 80 % of the heads"
_FARTHEST_STATIC_M: Final = 2.5
"""Depth of the farthest static point, m (physical: the article's Table 5)."""


def article_result(method: str, axis: str) -> ReportedResult:
    """The article's mean absolute error of a method and axis."""
    return reported_result(NAME, "mean absolute error", method, axis)


def column_by_head(table: pd.DataFrame, group: str, method: str, column: str) -> FloatArray:
    """(heads,) one column of the table, by head."""
    rows = rows_where(table, case="head", group=group, method=method)
    return np.asarray(rows.sort_values("head")[column].to_numpy(), dtype=np.float64)


def population_rank(
    table: pd.DataFrame, method: str, axis: str, group: str = "population"
) -> twin.RankInPopulation:
    """Placement of the article's mean absolute error among the heads'."""
    ours = column_by_head(table, group, method, f"mean_abs_{axis}_mm")
    return twin.rank_in_population(article_result(method, axis).low, ours)


def summarise(table: pd.DataFrame, config: PhysicalMovingConfig) -> list[SummaryRow]:
    """Rows of the summary: median and middle 80 % of the heads, and the head with images."""
    del config
    rows, quantity = [], "mean absolute error"
    for axis in AXES:
        for method in METHODS:
            rank = population_rank(table, method, axis)
            rows.append(_row(quantity, method, axis, rank.article, rank.median))
            rows.append(_rank_row(quantity, method, axis, rank))
            seen = float(column_by_head(table, "imaged", method, f"mean_abs_{axis}_mm")[0])
            rows.append(_row(f"{quantity}, head with images", method, axis, None, seen))
        rows.append(_rank_row(f"{quantity}, gaze less ITPC", "both", axis, _apart(table, axis)))
    for method in METHODS:
        rank = population_rank(table, method, "y", "half tilt")
        rows.append(_rank_row(f"{quantity}, half the common tilt", method, "y", rank))
    return rows


def _rank_row(quantity: str, method: str, axis: str, rank: twin.RankInPopulation) -> SummaryRow:
    ours = (rank.low, rank.high)
    return _row(f"{quantity}{_MIDDLE}", method, axis, rank.article, ours, rank.verdict)


def _apart(table: pd.DataFrame, axis: str) -> twin.RankInPopulation:
    """Placement of the article's difference between the methods among the heads'."""
    gaze, itpc = (column_by_head(table, "population", m, f"mean_abs_{axis}_mm") for m in METHODS)
    article = round(article_result("gaze", axis).low - article_result("itpc", axis).low, 2)
    return twin.rank_in_population(article, gaze - itpc)


def numbers(table: pd.DataFrame, config: PhysicalMovingConfig) -> Numbers:
    """The numbers of the text."""
    row = rows_where(table, case="twin").iloc[0]
    x_mm, _, z_mm = config.middle_mm
    tilt = max(article_result(method, "y").low for method in METHODS) / z_mm
    values = {
        "scale_ratio": float(row["scale"]),
        "inside_count": twin.count_inside(
            [population_rank(table, m, a) for m in METHODS for a in AXES]
        ),
        # the error in x that follows from the depth error along the line of sight
        "along_sight_mm": abs(x_mm / z_mm) * article_result("gaze", "z").low,
        "article_tilt_deg": float(np.rad2deg(tilt)),
        "article_tilt_far_mm": 1000.0 * tilt * _FARTHEST_STATIC_M,
        "middle_m": z_mm / 1000.0,
        "assumed_tilt_deg": float(np.rad2deg(config.errors.common_tilt_rad)),
        "common_tilt_deg": row["scale"] * float(np.rad2deg(config.errors.common_tilt_rad)),
        "imaged_head": float(row["head"]),
    }
    for method in METHODS:
        placed = population_rank(table, method, "y", "half tilt")
        values |= {f"half_{method}_low_mm": placed.low, f"half_{method}_high_mm": placed.high}
    for axis, velocity in zip(AXES, config.velocity_mm_s, strict=True):
        gaze, itpc = (column_by_head(table, "population", m, f"mean_{axis}_mm") for m in METHODS)
        apart = _apart(table, axis)
        values |= {
            f"trail_{axis}_mm": float(np.median(gaze - itpc)),
            f"lag_{axis}_mm": -velocity / ARTICLE_GAIN,
            f"apart_{axis}_low_mm": apart.low,
            f"apart_{axis}_high_mm": apart.high,
        }
        for method in METHODS:
            own = column_by_head(table, "imaged", method, f"mean_abs_{axis}_mm")
            values[f"imaged_{method}_{axis}_mm"] = float(own[0])
    return values


_COLOUR: Final = {"gaze": style.BLUE, "itpc": style.ORANGE}


def draw(table: pd.DataFrame, config: PhysicalMovingConfig) -> dict[str, Figure]:
    """All figures by name."""
    del config
    return {
        "fig12-trajectory": _trajectory(table),
        "fig13-absolute-errors-physical": _errors(table),
        "fig13-population": _population(table),
    }


def _trajectory(table: pd.DataFrame) -> Figure:
    figure = style.new_figure(9.0, 4.2)
    rows = rows_where(table, case="time")
    for panel, axis in zip(figure.subplots(1, 2), ("x", "y"), strict=True):
        truth = rows_where(rows, method="gaze")
        panel.plot(truth["truth_z_mm"], truth[f"truth_{axis}_mm"], color=style.BLACK, linewidth=2.5,
                   label="truth")  # fmt: skip
        for method in METHODS:
            own = rows_where(rows, method=method)
            label = f"{twin.METHOD_LABELS[method]}, images"
            look = twin.method_look(method, 8, linestyle="none", markersize=5, label=label)
            panel.plot(
                own["truth_z_mm"] + own["error_z_mm"],
                own[f"truth_{axis}_mm"] + own[f"error_{axis}_mm"],
                **look,
            )
        panel.set(xlabel="z [mm]", ylabel=f"{axis} [mm]")
    style.legend_below(figure, 3)
    return figure


def _errors(table: pd.DataFrame) -> Figure:
    figure = style.new_figure(9.6, 4.2)
    rows, bands = rows_where(table, case="time"), rows_where(table, case="band")
    for panel, axis in zip(figure.subplots(1, 3), AXES, strict=True):
        band = rows_where(bands, axis=axis, method="gaze")
        panel.fill_between(band["time_s"], band["low_mm"], band["high_mm"], color=style.GREY,
                           alpha=0.25, linewidth=0.0, label="heads by gaze, 10-90 %")  # fmt: skip
        panel.plot(band["time_s"], band["median_mm"], color=style.GREY, linewidth=1.2,
                   label="median head")  # fmt: skip
        for method, dash in zip(METHODS, ("--", ":"), strict=True):
            own = rows_where(rows, method=method)
            panel.plot(own["time_s"], own[f"error_{axis}_mm"].abs(), color=_COLOUR[method],
                       linestyle=style.METHOD_STYLE[method]["linestyle"],
                       label=f"{twin.METHOD_LABELS[method]}, images")  # fmt: skip
            panel.axhline(article_result(method, axis).low,
                          label=f"article, {twin.METHOD_LABELS[method]}",
                          **{**style.ARTICLE_STYLE, "linestyle": dash})  # fmt: skip
        panel.set(xlabel="time [s]", ylabel=f"|error in {axis}| [mm]", ylim=(0.0, None))
    style.legend_below(figure, 3)
    return figure


def _population(table: pd.DataFrame) -> Figure:
    figure = style.new_figure(8.0, 4.2)
    panel = figure.subplots()
    for k, (axis, method) in enumerate((a, m) for a in AXES for m in METHODS):
        placed = population_rank(table, method, axis)
        own = column_by_head(table, "population", method, f"mean_abs_{axis}_mm")
        panel.plot(own, [k] * len(own), linestyle="none", marker="|", markersize=9,
                   color=_COLOUR[method], alpha=0.5,
                   label="a head" if k == 0 else None)  # fmt: skip
        panel.plot([placed.low, placed.high], [k, k], color=_COLOUR[method], linewidth=7,
                   alpha=0.35, solid_capstyle="butt",
                   label="heads, 10-90 %" if k == 0 else None)  # fmt: skip
        panel.plot(placed.article, k, linestyle="none", marker="D", color=style.BLACK, markersize=8,
                   label="article" if k == 0 else None)  # fmt: skip
    panel.set_yticks(range(6), [f"{a}, {twin.METHOD_LABELS[m]}" for a in AXES for m in METHODS])
    panel.invert_yaxis()
    panel.set_xlim(left=0.0)
    panel.set_xlabel("mean absolute error of a head along the line [mm]")
    style.legend_below(figure, 3)
    return figure


EXPERIMENT: Final = Experiment(
    name="physical-moving", title="Physical twin, moving target",
    article="Section 5.1.2, Figures 12 and 13",
    text=read_template(__package__, "sections/physical_moving.jinja"), config=PhysicalMovingConfig,
    quick={
        "heads": 40, "every": 4, "table_every": 10, "speed_m_s": 0.03, "noise_poses": 2,
        "noise_frames": 10,
    },
    run=run, summarise=summarise, numbers=numbers, draw=draw,
)  # fmt: skip
