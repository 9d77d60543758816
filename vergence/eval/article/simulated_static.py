"""Static targets on the simulated rig: Table 3, Figures 6 and 7."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from math import radians
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vergence.eval.article import closed_loop
from vergence.eval.article.closed_loop import MM, ClosedLoop, GazeRecord, hold_gaze
from vergence.eval.article.experiment import Experiment, SummaryRow, job_rng, job_seed, rows_where
from vergence.eval.article.reported import (
    ReportedResult,
    reported_result,
    reported_results,
    static_points,
)
from vergence.models.head import HeadModel
from vergence.models.head_file import load_head
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.models.perturbation import ModelErrors
from vergence.reporting import style
from vergence.reporting.jobs import Job, Mapper
from vergence.reporting.text import Numbers, read_template
from vergence.triangulation import Fix

_DRAW: Final = "simulated-rig"


DRAWN_ERRORS: Final = ModelErrors(
    link_m=5e-5, coaxiality_rad=radians(0.02), joint_offset_rad=radians(0.02),
    head_eye_rad=radians(0.02), head_eye_m=1e-4, focal_relative=5e-4, principal_px=0.3,
)  # fmt: skip
"""Standard deviations of the model errors drawn for the simulated rig."""


class RigCase(NamedTuple):
    """One set of model errors."""

    title: str
    """Short title for figures."""
    true_head: Callable[[HeadModel, ModelErrors, int], HeadModel]
    """Function from (the preset, the errors' standard deviations, the run's seed)."""


def _centred(preset: HeadModel, _errors: ModelErrors, _seed: int) -> HeadModel:
    """The preset with its principal points at the true image centres.

    With pixel centres at integers these are ((W - 1) / 2, (H - 1) / 2); Table 2 says
    ((W + 1) / 2, (H + 1) / 2).
    """
    return preset.replace(cameras={"principal": (preset.cameras.size - 1) / 2.0})


def _drawn(preset: HeadModel, errors: ModelErrors, seed: int) -> HeadModel:
    return preset.perturbed(job_rng(seed, _DRAW, 0), errors)


CASES: Final[dict[str, RigCase]] = {
    "exact": RigCase("exact model", lambda preset, _errors, _seed: preset),
    "principal": RigCase("principal point 1 px off", _centred),
    "drawn": RigCase("drawn model errors", _drawn),
}
"""The cases by name, in the order of the figures; a further one is one more entry."""


NAME: Final = "simulated-static"
BOARD: Final = {"board": "checkerboard", "facing": "forward"}
"""The article's target: the upper right corner of a checkerboard perpendicular to z."""


@dataclass(frozen=True, kw_only=True)
class SimulatedStaticConfig:
    """Configuration of static targets on the simulated rig."""

    samples: int = 1150
    """Detections at each point after settling; the article's n."""
    point_step: int = 1
    """Step through the 21 points, from the first."""
    settle_s: float = 2.0
    """Settling time from the target's appearance, eyes at rest, to the first sample, s."""
    gain: float = 4.0
    """The law's gain, 1/s."""
    dither_side: int = 4
    """Number of references per side of a dithered fixation's grid; the grid is one pixel wide,
    around the principal point."""
    heads: int = 100
    """Number of heads drawn, to see how representative the single drawn model is."""
    errors: ModelErrors = DRAWN_ERRORS
    """Standard deviations of the drawn model errors."""


def run(config: SimulatedStaticConfig, seed: int, mapper: Mapper) -> pd.DataFrame:
    """See `vergence.eval.article.experiment.Experiment`."""
    points = range(0, len(static_points("simulated")), config.point_step)
    runs = [(case, "still") for case in CASES]
    # dithering reduces the detector's bias, the only systematic error of the exact model
    runs.append(("exact", "dithered"))
    jobs: list[Job] = [
        partial(_look, config, seed, case, fixation, point)
        for case, fixation in runs
        for point in points
    ]
    jobs += [partial(_population, config, seed, point) for point in points]
    return pd.DataFrame([row for rows in mapper(jobs) for row in rows])


def _target(point: int) -> dict[str, Any]:
    return {"kind": "static", "point": static_points("simulated")[point].tolist()}


def _look(
    config: SimulatedStaticConfig, seed: int, case: str, fixation: str, point: int
) -> list[dict[str, Any]]:
    """Hold one point with rendered images; returns a row for each method and axis."""
    nominal, dithered = load_head("simulated"), fixation == "dithered"
    references = closed_loop.dither_references_px(config.dither_side)
    loop = ClosedLoop(
        head=nominal, true_head=CASES[case].true_head(nominal, config.errors, seed),
        target=_target(point), plant_options=BOARD, samples=config.samples,
        settle_s=config.settle_s, gain=config.gain,
        references_px=references if dithered else ((0.0, 0.0),),
        seed=job_seed(seed, NAME, list(CASES).index(case), int(dithered), point),
    )  # fmt: skip
    record = hold_gaze(loop)
    common = {"case": case, "images": "rendered", "fixation": fixation, "head": 0}
    common |= _detections(record, dithered)
    return list(_rows(common, nominal, record, point, dithered))


def _detections(record: GazeRecord, dithered: bool) -> dict[str, float]:
    """Noise and bias of the detections, and the fraction of images with detections."""
    noise = record.pixels - record.true_pixels_at_exposure
    sigma = closed_loop.detection_sigma(record.pixels)
    columns = {"seen": float(np.isfinite(record.pixels).all(axis=(1, 2)).mean())}
    for eye, name in enumerate(EYE_NAMES):
        for axis, letter in enumerate("uv"):
            tail = f"{name}_{letter}_px"
            # dithering moves the target in the image on purpose: its sigma is not noise
            columns[f"detection_sigma_{tail}"] = np.nan if dithered else float(sigma[eye, axis])
            columns[f"detection_bias_{tail}"] = float(np.nanmean(noise[:, eye, axis]))
    return columns


def _rows(
    common: dict[str, Any],
    head: HeadModel,
    record: GazeRecord,
    point: int,
    dithered: bool,
) -> Iterator[dict[str, Any]]:
    q, truth = record.positions_at_exposure, record.target_at_exposure
    mean_q, mean_pixels = q.mean(axis=0), np.nanmean(record.pixels, axis=0)
    sigma = closed_loop.detection_sigma(record.pixels)
    uncertainty = {
        "gaze": closed_loop.gaze_uncertainty_mm(head, record.positions.mean(axis=0), sigma),
        "itpc": closed_loop.itpc_uncertainty_mm(head, mean_q, mean_pixels, sigma),
    }
    errors = {"gaze": record.gaze_error_mm, "itpc": record.itpc_error_mm}
    if dithered:
        corrected = closed_loop.corrected_gaze_fix(
            head, q, record.pixel_error, _depths(head, q, record.itpc)
        )
        errors["gaze"] = MM * (corrected.point - truth)
    for method, error in errors.items():
        for axis, letter in enumerate("xyz"):
            yield {
                **common, "point": point + 1, "depth_mm": MM * float(truth[0, 2]),
                "method": method, "axis": letter, "n": int(np.isfinite(error[:, axis]).sum()),
                "error_mm": float(np.nanmean(error[:, axis])),
                "standard_deviation_mm": float(np.nanstd(error[:, axis], ddof=1)),
                "uncertainty_mm": np.nan if dithered else float(uncertainty[method][axis]),
            }  # fmt: skip


def _depths(head: HeadModel, q: FloatArray, fix: Fix) -> FloatArray:
    """(n, 2) depths of fixes in each eye's camera frame, m."""
    poses = head.camera_poses(q)
    offset = fix.point[:, None, :] - poses[..., :3, 3]
    return np.asarray((poses[..., :3, 2] * offset).sum(axis=-1))


def _population(config: SimulatedStaticConfig, seed: int, point: int) -> list[dict[str, Any]]:
    """Gaze errors of many drawn heads at one point, without images and noise."""
    preset = load_head("simulated")
    loop = ClosedLoop(
        head=preset, num=config.heads, target=_target(point),
        # independent of the head of the case `drawn`
        true_head=preset.perturbed(job_rng(seed, _DRAW, 1), config.errors, config.heads),
        plant="kinematic", plant_options={"detection_noise_px": 0.0}, samples=1,
        settle_s=max(config.settle_s, 3.0), gain=config.gain,
    )  # fmt: skip
    record = hold_gaze(loop)
    error, depth = record.gaze_error_mm[0], MM * float(record.target[0, 0, 2])
    return [
        {
            "case": "drawn", "images": "none", "fixation": "still", "head": number + 1,
            "seen": 1.0, "point": point + 1, "depth_mm": depth, "method": "gaze", "axis": letter,
            "n": 1, "error_mm": float(error[number, axis]),
        }
        for number in range(config.heads)
        for axis, letter in enumerate("xyz")
    ]  # fmt: skip


ARTICLE_NAME: Final = "simulated static"
"""Name of this experiment in the table of the article's results."""
_row = partial(SummaryRow.of, ARTICLE_NAME)
ARTICLE_CASE: Final = "principal"
"""Case that represents the article's rig: Table 2's camera matrix on a centred image."""
ARTICLE_Z_PERCENT: Final = 0.5
"""Greatest absolute error in z, percent of depth (physical: reported by the article)."""
ARTICLE_DETECTION_PX: Final = (0.006, 0.057)
"""Least and greatest sample standard deviation of the detections, px (physical: reported by the
article)."""
# Our targets for errors of the mean fix with the exact model; half of them for dithered fixations
# (chosen). Greatest and median error in z, percent of depth; greatest error in x or y, mm.
Z_WORST_PERCENT: Final = 0.4
Z_MEDIAN_PERCENT: Final = 0.1
XY_WORST_MM: Final = 0.3
STANDARD_ERRORS: Final = 5.0
"""Largest error of a mean, in standard errors, attributed to chance (chosen)."""


def article_result(quantity: str, axis: str, method: str = "both") -> ReportedResult:
    """A result that the article reports of this experiment."""
    return reported_result(ARTICLE_NAME, quantity, method, axis)


def select_fixes(
    table: pd.DataFrame, case: str, fixation: str = "still", images: str = "rendered"
) -> pd.DataFrame:
    """The rows of one case and kind of fixation."""
    return rows_where(table, case=case, fixation=fixation, images=images)


class MeanFixErrors(NamedTuple):
    """Absolute errors of the mean fixes of some rows, over points and methods."""

    low_mm: dict[str, float]
    """Least absolute error by axis, mm."""
    high_mm: dict[str, float]
    """Greatest absolute error by axis, mm."""
    z_percent: tuple[float, float, float]
    """Absolute error in z, percent of depth: least, median, greatest."""
    greatest_standard_errors: float
    """Greatest error of an ITPC mean, in standard errors from the scatter of its single fixes."""

    @classmethod
    def of(cls, rows: pd.DataFrame) -> "MeanFixErrors":
        """The errors of some rows."""
        absolute = rows["error_mm"].abs()
        by_axis = absolute.groupby(rows["axis"])
        deep = rows["axis"] == "z"
        share = 100.0 * absolute[deep] / rows["depth_mm"][deep]
        itpc = rows_where(rows, method="itpc")
        errors = itpc["error_mm"].abs() * np.sqrt(itpc["n"]) / itpc["standard_deviation_mm"]
        return cls(
            {axis: float(by_axis.min()[axis]) for axis in "xyz"},
            {axis: float(by_axis.max()[axis]) for axis in "xyz"},
            (float(share.min()), float(share.median()), float(share.max())), float(errors.max()),
        )  # fmt: skip


def errors_by_case(table: pd.DataFrame) -> dict[str, MeanFixErrors]:
    """Errors of the still fixations of each case in the table."""
    still = {case: select_fixes(table, case) for case in CASES}
    return {case: MeanFixErrors.of(rows) for case, rows in still.items() if len(rows)}


def dithered_errors(table: pd.DataFrame) -> MeanFixErrors:
    """Errors of the exact model's dithered fixations."""
    return MeanFixErrors.of(select_fixes(table, "exact", "dithered"))


def numbers(table: pd.DataFrame, config: SimulatedStaticConfig) -> Numbers:
    """The numbers of the text."""
    del config
    cases, exact = errors_by_case(table), select_fixes(table, "exact")
    found: dict[str, float] = {
        "points": exact["point"].nunique(),
        "nearest_m": float(exact["depth_mm"].min()) / 1000.0,
        "farthest_m": float(exact["depth_mm"].max()) / 1000.0,
        "article_z_percent": ARTICLE_Z_PERCENT,
        "target_z_worst_percent": Z_WORST_PERCENT,
        "target_z_median_percent": Z_MEDIAN_PERCENT,
        "target_xy_mm": XY_WORST_MM,
        **_drawn_heads(table),
        **_methods_apart(table),
    }
    for name, errors in {**cases, "dithered": dithered_errors(table)}.items():
        for axis in "xyz":
            found[f"{name}_{axis}_low_mm"] = errors.low_mm[axis]
            found[f"{name}_{axis}_high_mm"] = errors.high_mm[axis]
        found[f"{name}_z_median_percent"] = errors.z_percent[1]
        found[f"{name}_z_high_percent"] = errors.z_percent[2]
        found[f"{name}_standard_errors"] = errors.greatest_standard_errors
    for axis in "xy":
        low, high = article_result("absolute error", axis).span
        found[f"article_{axis}_low_mm"], found[f"article_{axis}_high_mm"] = low, high
    implied = implied_noise_px()
    for axis, (near, far) in implied.items():
        found[f"implied_{axis}_near_px"], found[f"implied_{axis}_far_px"] = near, far
    found["implied_low_px"] = min(map(min, implied.values()))
    found["implied_high_px"] = max(map(max, implied.values()))
    found["article_noise_low_px"], found["article_noise_high_px"] = ARTICLE_DETECTION_PX
    found["noise_low_px"], found["noise_high_px"] = detection_noise_px(table)
    found["bias_high_px"] = float(exact.filter(like="detection_bias_").abs().to_numpy().max())
    return found


def detection_noise_px(table: pd.DataFrame) -> tuple[float, float]:
    """Least and greatest sample standard deviation of the detections with the exact model, px."""
    sigma = select_fixes(table, "exact").filter(like="detection_sigma_").to_numpy()
    return float(sigma.min()), float(sigma.max())


def _methods_apart(table: pd.DataFrame) -> dict[str, float]:
    """Numbers on the differences of both methods' means and scatter on settled targets."""
    rendered = pd.concat([select_fixes(table, case) for case in CASES])
    keys = ["case", "point", "axis"]
    wide = rendered.pivot_table(index=keys, columns="method", values="error_mm")
    difference = (wide["gaze"] - wide["itpc"]).abs()
    itpc = rows_where(rendered, method="itpc").set_index(keys)
    error = itpc["standard_deviation_mm"] / np.sqrt(itpc["n"])
    exact = select_fixes(table, "exact")
    scatter = rows_where(exact, axis="z").pivot_table(
        index="point", columns="method", values="standard_deviation_mm"
    )
    return {
        "apart_high_mm": float(difference.max()),
        "apart_standard_errors": float((difference / error).max()),
        "scatter_ratio": float((scatter["gaze"] / scatter["itpc"]).median()),
    }


def _drawn_heads(table: pd.DataFrame) -> dict[str, float]:
    """Numbers comparing the drawn heads' errors with the article's in x and z together.

    A head counts as like the article's if its greatest error in x is within a factor of two of the
    article's and its greatest error in z, over depth, is not above the article's.
    """
    heads = select_fixes(table, "drawn", images="none")
    absolute = heads.assign(error_mm=heads["error_mm"].abs())
    worst = absolute.pivot_table(index="head", columns="axis", values="error_mm", aggfunc="max")
    deep = rows_where(absolute, axis="z")
    share = (100.0 * deep["error_mm"] / deep["depth_mm"]).groupby(deep["head"]).max()
    _, article_x = article_result("absolute error", "x").span
    like = worst["x"].between(0.5 * article_x, 2.0 * article_x) & (share <= ARTICLE_Z_PERCENT)
    far = absolute[absolute["point"] == absolute["point"].max()]
    last = far.pivot_table(index="head", columns="axis", values="error_mm")
    depth = float(absolute["depth_mm"].max())
    return {
        "heads": len(worst),
        "heads_like_percent": 100.0 * float(like.mean()),
        "heads_z_over_x": float((last["z"] / last["x"]).median()),
        "article_z_over_x": ARTICLE_Z_PERCENT / 100.0 * depth / article_x,
    }


def implied_noise_px() -> dict[str, tuple[float, float]]:
    """Detection noise implied by each extreme of Fig. 7, px by axis.

    The least uncertainty is that at the nearest point, the greatest that at the farthest.
    """
    unit = uncertainty_mm_per_px()
    implied = {}
    for axis, letter in enumerate("xyz"):
        least, greatest = article_result("uncertainty", letter).span
        implied[letter] = (float(least / unit[0, axis]), float(greatest / unit[-1, axis]))
    return implied


def uncertainty_mm_per_px() -> FloatArray:
    """(21, 3) uncertainty at Table 3's points per pixel of detection noise, mm/px."""
    head, points = load_head("simulated"), static_points("simulated")
    return closed_loop.gaze_uncertainty_mm(head, head.fixate(points), np.ones((len(points), 2, 2)))


def summarise(table: pd.DataFrame, config: SimulatedStaticConfig) -> list[SummaryRow]:
    """Rows of the summary: the article's under its own camera matrix, other cases, our targets."""
    rows = [_reported(row, select_fixes(table, ARTICLE_CASE)) for row in reported_results()
            if row.experiment == ARTICLE_NAME]  # fmt: skip
    cases, dithered = errors_by_case(table), dithered_errors(table)
    for case, errors in cases.items():
        title = CASES[case].title
        rows.append(_depth_share(title, errors))
        if case != ARTICLE_CASE:
            rows += _case_errors(title, errors)
    rows += _case_errors("exact model, dithered", dithered)
    rows.append(_depth_share("exact model, dithered", dithered))
    rows += _targets("exact model", cases["exact"], 1.0)
    rows += _targets("exact model, dithered", dithered, 0.5)
    low, high = ARTICLE_DETECTION_PX
    ours = detection_noise_px(table)
    rows.append(_row("detection noise", "both", "u, v", ARTICLE_DETECTION_PX, ours, unit="px"))
    for axis, pair in implied_noise_px().items():
        span = (min(pair), max(pair))
        verdict = "inside" if low <= span[0] and span[1] <= high else "outside"
        quantity = "detection noise implied by the article's uncertainty"
        rows.append(_row(quantity, "both", axis, ARTICLE_DETECTION_PX, span, verdict, "px"))
    for (method, letter), own in select_fixes(table, "exact").groupby(["method", "axis"]):
        scatter = own["standard_deviation_mm"]
        ours, quantity = (scatter.min(), scatter.max()), "standard deviation of single fixes"
        rows.append(_row(quantity, str(method), str(letter), None, ours))
    return [*rows, *_explanations(numbers(table, config))]


def _reported(r: ReportedResult, case: pd.DataFrame) -> SummaryRow:
    own = rows_where(case, axis=r.axis, **({} if r.method == "both" else {"method": r.method}))
    column = "error_mm" if r.quantity == "absolute error" else "uncertainty_mm"
    ours = (float(own[column].abs().min()), float(own[column].abs().max()))
    return _row(r.quantity, r.method, r.axis, (r.low, r.high), ours)


def _case_errors(title: str, errors: MeanFixErrors) -> Iterator[SummaryRow]:
    for axis in "xyz":
        theirs = None if axis == "z" else article_result("absolute error", axis).span
        ours = (errors.low_mm[axis], errors.high_mm[axis])
        yield _row(f"absolute error, {title}", "both", axis, theirs, ours)


def _depth_share(title: str, errors: MeanFixErrors) -> SummaryRow:
    low, _, high = errors.z_percent
    quantity, theirs = f"absolute error over depth, {title}", (None, ARTICLE_Z_PERCENT)
    return _row(quantity, "both", "z", theirs, (low, high), unit="%")


def _targets(title: str, errors: MeanFixErrors, factor: float) -> Iterator[SummaryRow]:
    _, median, worst = errors.z_percent
    for what, axis, unit, value, limit in (
        ("greatest error over depth", "z", "%", worst, Z_WORST_PERCENT),
        ("median error over depth", "z", "%", median, Z_MEDIAN_PERCENT),
        ("greatest error", "x", "mm", errors.high_mm["x"], XY_WORST_MM),
        ("greatest error", "y", "mm", errors.high_mm["y"], XY_WORST_MM),
    ):
        yield _target_row(f"{what}, {title}", "both", axis, value, factor * limit, unit)


def _target_row(
    quantity: str, method: str, axis: str, value: float, limit: float, unit: str
) -> SummaryRow:
    verdict = "target met" if value <= limit else "target missed"
    return _row(f"{quantity}, target {limit:g} {unit}", method, axis, None, value, verdict, unit)


def _explanations(found: Numbers) -> Iterator[SummaryRow]:
    """Summary rows on errors beyond chance, and on drawn errors like the article's."""
    for quantity, method, name in (
        ("greatest difference of the methods' means", "both", "apart"),
        ("greatest error of the mean, exact model", "itpc", "exact"),
        ("greatest error of the mean, exact model, dithered", "itpc", "dithered"),
    ):
        value, unit = found[f"{name}_standard_errors"], "standard errors"
        yield _target_row(quantity, method, "x, y, z", value, STANDARD_ERRORS, unit)
    yield _row("error in z over error in x at the farthest point, drawn heads", "gaze", "x, z",
               (None, found["article_z_over_x"]), found["heads_z_over_x"], unit="1")  # fmt: skip
    yield _row("drawn heads with the article's errors in x and z", "gaze", "x, z", None,
               found["heads_like_percent"], unit="%")  # fmt: skip


_CASE_STYLE: Final[dict[str, dict[str, Any]]] = {
    "exact": {"color": style.GREEN, "linestyle": "-"},
    "principal": {"color": style.BLUE, "linestyle": "--"},
    "drawn": {"color": style.ORANGE, "linestyle": "-."},
}
_UNCERTAINTIES: Final[tuple[tuple[str, str, dict[str, Any]], ...]] = (
    ("gaze", "uncertainty_mm", {"label": "gaze, Eqs. 27 to 33"}),
    ("itpc", "uncertainty_mm",
     {"label": "ITPC, Eqs. 34 to 36", "linestyle": "", "marker": "s", "markerfacecolor": "none"}),
    ("gaze", "standard_deviation_mm",
     {"label": "gaze, scatter of the closed loop", "linestyle": "-.", "marker": "o"}),
    ("itpc", "standard_deviation_mm",
     {"label": "ITPC, scatter of the closed loop", "linestyle": ":"}),
)  # fmt: skip
"""Curves of Figure 7: method, column and line style."""
_LEAST_MM: Final = 1e-4
"""Smallest error drawn on the logarithmic axis, mm; smaller ones are raised to it (numerical)."""


def draw(table: pd.DataFrame, config: SimulatedStaticConfig) -> dict[str, Figure]:
    """The figures by name."""
    return {
        "fig06-absolute-errors": _errors(table),
        "fig06-dithered-fixation": _dithered(table),
        "fig07-uncertainties": _uncertainties(table),
        "fig07-implied-detection-noise": _implied(table),
    }


def depth_panels(figure: Figure, unit: str) -> list[Axes]:
    """Three panels over the depth, for x, y and z."""
    axes = list(figure.subplots(1, 3))
    for axis, letter in zip(axes, "xyz", strict=True):
        axis.set(title=letter, xlabel="depth (m)")
        style.log_axis(axis)
    axes[0].set_ylabel(unit)
    return axes


def _by_depth(rows: pd.DataFrame, method: str, axis: str, column: str) -> tuple[Any, Any]:
    own = rows_where(rows, method=method, axis=axis).sort_values("depth_mm")
    return own["depth_mm"] / 1000.0, own[column].abs().clip(lower=_LEAST_MM)


def _errors(table: pd.DataFrame) -> Figure:
    figure = style.new_figure(9.5, 5.0)
    axes = depth_panels(figure, "absolute error of the mean (mm)")
    depth = static_points("simulated")[:, 2]
    for axis, letter in zip(axes, "xyz", strict=True):
        if letter == "z":
            label = f"article: {ARTICLE_Z_PERCENT:g} % of depth"
            axis.plot(depth, 10.0 * ARTICLE_Z_PERCENT * depth, **style.ARTICLE_STYLE, label=label)
            least = article_result("absolute error", "z", "gaze").low
            axis.plot(1.1, least, marker="*", markersize=9, linestyle="", color="black",
                      label="article's least")  # fmt: skip
        else:
            span = article_result("absolute error", letter).span
            axis.axhspan(*span, **style.ARTICLE_BAND, label="article's range")
        for case in CASES:
            look = _CASE_STYLE.get(case, {"color": style.PURPLE, "linestyle": ":"})
            rows = select_fixes(table, case)
            title = CASES[case].title
            axis.plot(*_by_depth(rows, "gaze", letter, "error_mm"), **look, label=f"{title}, gaze")
            axis.plot(
                *_by_depth(rows, "itpc", letter, "error_mm"), linestyle="", marker="s",
                markerfacecolor="none", color=look["color"], label=f"{title}, ITPC",
            )  # fmt: skip
    style.legend_below(figure, 3)
    return figure


def _dithered(table: pd.DataFrame) -> Figure:
    figure = style.new_figure(9.5, 4.4)
    axes = depth_panels(figure, "absolute error of the mean (mm)")
    depth = static_points("simulated")[:, 2]
    for axis, letter in zip(axes, "xyz", strict=True):
        worst = 10.0 * Z_WORST_PERCENT * depth if letter == "z" else XY_WORST_MM + 0.0 * depth
        axis.plot(depth, worst, **style.ARTICLE_STYLE, label="our target, still")
        axis.plot(depth, 0.5 * worst, color="black", linewidth=1.0, label="our target, dithered")
        for fixation, colour, marker in (
            ("still", style.BLUE, "o"),
            ("dithered", style.GREEN, "^"),
        ):
            rows = select_fixes(table, "exact", fixation)
            axis.plot(
                *_by_depth(rows, "itpc", letter, "error_mm"), color=colour, marker=marker,
                linestyle="-" if fixation == "still" else "--", label=f"{fixation} fixation, ITPC",
            )  # fmt: skip
    style.legend_below(figure, 2)
    return figure


def _uncertainties(table: pd.DataFrame) -> Figure:
    figure = style.new_figure(9.5, 5.0)
    axes = depth_panels(figure, "uncertainty, standard deviation (mm)")
    rows = select_fixes(table, ARTICLE_CASE)
    for axis, letter in zip(axes, "xyz", strict=True):
        span = article_result("uncertainty", letter).span
        axis.axhspan(*span, **style.ARTICLE_BAND, label="article's range")
        for method, column, look in _UNCERTAINTIES:
            color = style.METHOD_STYLE[method]["color"]
            axis.plot(*_by_depth(rows, method, letter, column), color=color, **look)
    style.legend_below(figure, 3)
    return figure


def _implied(table: pd.DataFrame) -> Figure:
    figure = style.new_figure(7.0, 3.6)
    axis = figure.subplots()
    axis.axhspan(*ARTICLE_DETECTION_PX, **style.ARTICLE_BAND, label="article's detection noise")
    lows, highs = zip(*implied_noise_px().values(), strict=True)
    axis.plot([-0.08, 0.92, 1.92], lows, marker="v", color=style.BLUE, linestyle="",
              label="implied by its least uncertainty, 0.5 m")  # fmt: skip
    axis.plot([0.08, 1.08, 2.08], highs, marker="^", color=style.ORANGE, linestyle="",
              label="implied by its greatest, 2.5 m")  # fmt: skip
    low, high = detection_noise_px(table)
    axis.plot([3, 3], [low, high], color=style.GREEN, linewidth=6, label="our detections")
    axis.set_xticks(range(4), ["x", "y", "z", "ours"])
    axis.set_xlim(-0.5, 3.5)
    axis.set_ylim(0.0, 0.065)
    axis.set_ylabel("detection noise (px)")
    style.legend_below(figure, 2)
    return figure


EXPERIMENT: Final = Experiment(
    name=NAME, title="Static targets on the simulated rig",
    article="Section 5.1.1, Tables 2 and 3, Figures 6 and 7",
    text=read_template(__package__, "sections/simulated_static.jinja"),
    config=SimulatedStaticConfig, quick={"samples": 60, "point_step": 10, "heads": 20},
    run=run, summarise=summarise, numbers=numbers, draw=draw,
)  # fmt: skip
