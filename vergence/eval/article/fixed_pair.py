"""Comparison of the head with a fixed pair of cameras: Tables 6 and 7, Figure 14."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vergence.eval.article import twin
from vergence.eval.article.closed_loop import MM, ClosedLoop, hold_gaze
from vergence.eval.article.experiment import Experiment, SummaryRow, job_rng, rows_where
from vergence.eval.article.reported import ReportedResult, reported_results, static_points
from vergence.eval.article.twin import AXES, METHODS
from vergence.models.camera import Camera, Cameras, camera_matrix
from vergence.models.head import HeadModel
from vergence.models.head_file import load_head
from vergence.models.parts import FloatArray
from vergence.models.perturbation import ModelErrors
from vergence.reporting import style
from vergence.reporting.jobs import Job, Mapper
from vergence.reporting.text import Numbers, read_template
from vergence.triangulation import triangulate_views
from vergence.vision.targets import board_pose

FACTORY_ERRORS: Final = ModelErrors(
    # 0.02 degrees of rotation between the two cameras, split between them
    head_eye_rad=float(np.deg2rad(0.02) / np.sqrt(2.0)),
    head_eye_m=0.00005,
    focal_relative=0.001,
    # about the reprojection error of a good calibration
    principal_px=0.2,
)
"""Residual errors of a fixed pair after factory calibration."""


@dataclass(frozen=True, kw_only=True)
class FixedPairConfig(twin.TwinConfig):
    """Configuration of the comparison with a fixed pair."""

    samples: int = 120
    """Fixes recorded at each point."""
    settle_s: float = 2.0
    """Settling time before the first fix, s."""
    pair_rig: str = "simulated"
    """Rig that gives the pair's images grey levels, blur and noise: a preset or TOML file."""
    pair_size_px: tuple[int, int] = (1280, 720)
    """Width and height of the pair's images, px."""
    pair_focal_px: float = 676.21
    """Focal length of the pair's cameras, px (Table 6)."""
    pair_principal_px: tuple[float, float] = (645.09, 368.27)
    """Principal point of the pair's cameras, px (Table 6)."""
    pair_baseline_mm: float = 63.0
    """Baseline of the pair, mm."""
    pair_place_mm: tuple[float, float, float] = (0.0, -90.0, 14.0)
    """Centre of the pair, above the eyes, in N, mm."""
    calibration: ModelErrors = FACTORY_ERRORS
    """Errors left by factory calibration; head-eye errors apply to the pair's camera poses."""
    mount_rotation_deg: float = 2.0
    """Standard deviation of the pair's unknown orientation in N, about each axis, degrees."""
    mount_place_mm: float = 20.0
    """Standard deviation of the pair's unknown position in N, along each axis, mm."""


def run(config: FixedPairConfig, seed: int, mapper: Mapper) -> pd.DataFrame:
    """Measure Table 7's points with the population and with as many drawn pairs.

    The table's `case` is `twin` (one row), `detector` (one row per point) or `fix` (one row per
    draw, point and method). The methods are `gaze` and `itpc` of the drawn head, `pair` of the
    drawn pair, and `misaligned` of that pair with an unknown pose in N.
    """
    drawn = twin.draw_population(config, seed, mapper)
    points = static_points("zed_mini")
    pair = pair_head(config)
    jobs: list[Job] = [
        partial(_noise, pair, point, config, seed, i) for i, point in enumerate(points)
    ]
    measured, jobs = twin.DetectorNoise.stacked(mapper(jobs)), []
    for number, point in enumerate(points, 1):
        loop = drawn.hold_static_target(
            number, point, samples=config.samples, settle_s=config.settle_s, seed=seed
        )
        jobs.append(partial(_by_heads, loop, number))
    by_heads, by_pairs = mapper(jobs), _by_pairs(pair, points, measured, config, seed)
    frames: list[pd.DataFrame] = [drawn.table_row(), measured.table(points), *by_heads, by_pairs]
    return pd.concat(frames, ignore_index=True)


def pair_head(config: FixedPairConfig) -> HeadModel:
    """The fixed pair as a head whose joints never move: parallel cameras, axes along z_N."""
    rig = load_head(config.pair_rig)
    wanted = np.broadcast_to(np.eye(4), (2, 4, 4)).copy()
    half = 0.5 * config.pair_baseline_mm
    wanted[:, :3, 3] = np.array(config.pair_place_mm) / MM
    wanted[:, 0, 3] += np.array([-half, half]) / MM
    # T_N_C = T_N_6 T_6_C, so this T_6_C gives the cameras the wanted poses at rest
    head_eye = rig.head_eye @ np.linalg.inv(rig.camera_poses(rig.rest())) @ wanted
    matrix = camera_matrix([config.pair_focal_px] * 2, config.pair_principal_px)
    cameras = (Camera(size=config.pair_size_px, matrix=matrix, pose=pose) for pose in head_eye)
    return dataclasses.replace(rig, name="pair", cameras=Cameras(*cameras))


def _noise(
    pair: HeadModel, point: FloatArray, config: FixedPairConfig, seed: int, number: int
) -> twin.DetectorNoise:
    """Scatter and bias of the pair's detections at one point."""
    rng = job_rng(seed, "fixed pair detector", number)
    half_pixel = 0.5 * point[2] / config.pair_focal_px
    around = point + rng.uniform(-half_pixel, half_pixel, (config.noise_poses, 3))
    boards = np.stack([board_pose(p) for p in around])
    T_C_T = np.linalg.inv(pair.camera_poses(pair.rest())) @ boards[:, None]
    cameras = (Camera.of(pair, 0), Camera.of(pair, 1))
    return twin.measure_pair_noise(cameras, pair.rendering, T_C_T, config.noise_frames, rng)


def _by_heads(loop: ClosedLoop, number: int) -> pd.DataFrame:
    record = hold_gaze(loop)
    truth = record.target[0]
    errors = {"gaze": record.gaze_error_mm, "itpc": record.itpc_error_mm}
    return pd.concat(
        [_rows(m, number, truth, np.nanmean(error, axis=0)) for m, error in errors.items()]
    )


def _by_pairs(
    pair: HeadModel,
    points: FloatArray,
    noise: twin.DetectorNoise,
    config: FixedPairConfig,
    seed: int,
) -> pd.DataFrame:
    """Draw as many pairs as heads; each fix is from the mean of as many images as the head's."""
    rng = job_rng(seed, "fixed pair")
    count = config.heads
    true = pair.perturbed(rng, config.calibration, count)
    turn = np.deg2rad(config.mount_rotation_deg) * rng.standard_normal((count, 3))
    shift = config.mount_place_mm / MM * rng.standard_normal((count, 3))
    place = np.array(config.pair_place_mm) / MM
    frames = []
    for i, point in enumerate(points):
        pixels = true.project(pair.rest(), point)
        pixels = pixels + noise.bias_px[i] * rng.standard_normal(pixels.shape)
        scatter = noise.sigma_px[i] / np.sqrt(config.samples)
        pixels = pixels + scatter * rng.standard_normal(pixels.shape)
        found = triangulate_views(pair, pair.rest(), pixels).point
        # small rotations: rotate the pair's fix about its centre
        moved = found + np.cross(turn, found - place) + shift
        truth = np.broadcast_to(point, found.shape)
        frames.append(_rows("pair", i + 1, truth, MM * (found - point)))
        frames.append(_rows("misaligned", i + 1, truth, MM * (moved - point)))
    return pd.concat(frames)


def _rows(method: str, number: int, truth: FloatArray, error_mm: FloatArray) -> pd.DataFrame:
    return pd.DataFrame({
        "case": "fix", "draw": np.arange(len(error_mm)), "point": number, "method": method,
        "truth_z_mm": MM * truth[:, 2], **twin.axis_columns(error=error_mm.T),
    })  # fmt: skip


NAME: Final = "versus ZED Mini"
_row = partial(SummaryRow.of, NAME)
_BASELINE_M: Final = 0.092
"""Baseline of the head's eyes, m (physical: the article's head)."""


def article_results() -> list[ReportedResult]:
    """The article's rows of this experiment."""
    return [r for r in reported_results() if r.experiment == NAME]


def fix_errors_mm(table: pd.DataFrame, method: str, axis: str) -> FloatArray:
    """(draws, points) errors against the truth, mm."""
    rows = rows_where(table, case="fix", method=method)
    wide = rows.pivot(index="draw", columns="point", values=f"error_{axis}_mm")
    return np.asarray(wide.to_numpy(), dtype=np.float64)


def absolute_differences_mm(table: pd.DataFrame, method: str, axis: str, pair: str) -> FloatArray:
    """(draws, points) absolute differences of head and pair, mm; `both` joins both methods."""
    methods = METHODS if method == "both" else (method,)
    other = fix_errors_mm(table, pair, axis)
    return np.concatenate([np.abs(fix_errors_mm(table, m, axis) - other) for m in methods], axis=1)


def population_ranks(
    table: pd.DataFrame, r: ReportedResult, pair: str
) -> tuple[twin.RankInPopulation, ...]:
    """Ranks of the article's least and greatest difference among ours."""
    return twin.rank_ends(r.span, absolute_differences_mm(table, r.method, r.axis, pair))


class Misalignment(NamedTuple):
    """Error of the pair's pose in N that would explain a range of differences along x or y."""

    low_mm: float
    high_mm: float
    rotation_deg: float
    """Best fit by a rotation alone: yaw for x, pitch for y."""
    rotation_low_mm: float
    rotation_high_mm: float
    """Range of differences under that rotation."""
    rotation_with_shift_deg: float
    """Rotation that, with `shift_mm`, gives the range exactly."""
    shift_mm: float

    @property
    def misfit_mm(self) -> float:
        """Largest difference between an end of the article's range and of the rotation's."""
        ends = (self.rotation_low_mm - self.low_mm, self.rotation_high_mm - self.high_mm)
        return max(map(abs, ends))


def explaining_misalignment(r: ReportedResult, pair_z_mm: float) -> Misalignment:
    """Misalignment that explains a range in x or y if heads and pair have no other errors.

    A rotation by a small angle t shifts a point at distance z by t z, so differences grow with
    depth. The least difference is taken to belong to the nearest point, the greatest to the
    farthest.
    """
    low, high = r.span
    depth = 1000.0 * static_points("zed_mini")[:, 2] - pair_z_mm
    near, far = float(depth.min()), float(depth.max())
    turn = (near * low + far * high) / (near**2 + far**2)
    slope = (high - low) / (far - near)
    return Misalignment(
        low, high, float(np.rad2deg(turn)), turn * near, turn * far,
        float(np.rad2deg(slope)), low - slope * near,
    )  # fmt: skip


def explaining_misalignments(config: FixedPairConfig) -> dict[str, Misalignment]:
    """Misalignments that explain the article's ranges along x and y, by axis."""
    z_mm, rows = config.pair_place_mm[2], article_results()
    return {r.axis: explaining_misalignment(r, z_mm) for r in rows if r.axis in ("x", "y")}


def summarise(table: pd.DataFrame, config: FixedPairConfig) -> list[SummaryRow]:
    """Rows of the summary: medians over the draws of the least and the greatest difference."""
    rows = []
    for quantity, pair in (
        ("absolute difference", "pair"),
        ("absolute difference, pair's pose unknown", "misaligned"),
    ):
        for r in article_results():
            ours = tuple(rank.median for rank in population_ranks(table, r, pair))
            rows.append(_row(quantity, r.method, r.axis, r.span, ours))
    for method in _METHODS:
        for axis in AXES:
            low, high = np.percentile(_means(table, method, axis), [10.0, 90.0])
            rows.append(_row("mean absolute error", method, axis, None, (low, high)))
    ratio, quantity = _depth_ratio(table), "mean absolute error, median head over median pair"
    nearer = "pair nearer" if ratio > 1.0 else "head nearer"
    rows.append(_row(quantity, "gaze", "z", None, ratio, nearer, "1"))
    for axis, m in explaining_misalignments(config).items():
        verdict = "agrees" if m.misfit_mm < 0.1 * m.high_mm else "differs"
        ours = (m.rotation_low_mm, m.rotation_high_mm)
        quantity = "absolute difference, by a turn of the pair alone"
        rows.append(_row(quantity, "both", axis, (m.low_mm, m.high_mm), ours, verdict))
    return rows


def _means(table: pd.DataFrame, method: str, axis: str) -> FloatArray:
    """(draws,) mean absolute errors over the points, mm."""
    return np.asarray(np.abs(fix_errors_mm(table, method, axis)).mean(axis=1))


def _depth_ratio(table: pd.DataFrame) -> float:
    """Ratio of the median head's mean depth error to the median pair's."""
    gaze, pair = (float(np.median(_means(table, m, "z"))) for m in ("gaze", "pair"))
    return gaze / pair


def numbers(table: pd.DataFrame, config: FixedPairConfig) -> Numbers:
    """The numbers of the text."""
    detector = rows_where(table, case="detector")["sigma_px"]
    gaze, itpc, pair = (fix_errors_mm(table, method, "z") for method in ("gaze", "itpc", "pair"))
    inside = {
        pair: [twin.count_inside(population_ranks(table, r, pair)) for r in article_results()]
        for pair in ("pair", "misaligned")
    }
    most_m = max(r.span[1] for r in article_results() if r.axis == "z") / 1000.0
    far_m = float(static_points("zed_mini")[:, 2].max())
    # the rotation between the cameras is the difference of two independent rotations
    rotation = np.sqrt(2.0) * config.calibration.head_eye_rad
    values = {
        f"{method}_{axis}_mm": float(np.median(_means(table, method, axis)))
        for method in ("gaze", "pair")
        for axis in AXES
    } | {
        "sigma_least_px": float(detector.min()),
        "sigma_greatest_px": float(detector.max()),
        "depth_ratio": _depth_ratio(table),
        "closer_percent": 100.0 * float(np.mean(np.abs(gaze) < np.abs(pair))),
        "calibration_rotation_deg": float(np.rad2deg(rotation)),
        "inside_known_count": sum(inside["pair"]),
        "inside_unknown_count": sum(inside["misaligned"]),
        "reported_count": 2 * len(inside["pair"]),
        "far_m": far_m,
        "vergence_deg": float(np.rad2deg(most_m * _BASELINE_M / far_m**2)),
        "nearer_percent": 100.0 * float(np.mean(np.abs(gaze - pair) < np.abs(itpc - pair))),
        "apart_median_mm": float(np.median(np.abs(gaze - itpc))),
    }
    for axis, m in explaining_misalignments(config).items():
        values |= {
            f"turn_{axis}_deg": m.rotation_deg,
            f"turn_{axis}_least_mm": m.rotation_low_mm,
            f"turn_{axis}_greatest_mm": m.rotation_high_mm,
            f"both_{axis}_deg": m.rotation_with_shift_deg,
            f"shift_{axis}_mm": m.shift_mm,
        }
    return values


_PAIRS: Final[dict[str, dict[str, Any]]] = {
    "pair": {"color": style.BLUE, "marker": "o", "label": "pose known"},
    "misaligned": {"color": style.ORANGE, "marker": "s", "label": "pose unknown"},
}
_METHODS: Final[dict[str, dict[str, Any]]] = {
    "gaze": {"color": style.BLUE, "marker": "o", "label": "gaze"},
    "itpc": {"color": style.ORANGE, "marker": "s", "label": "ITPC"},
    "pair": {"color": style.GREEN, "marker": "^", "label": "fixed pair"},
}


def draw(table: pd.DataFrame, config: FixedPairConfig) -> dict[str, Figure]:
    """All figures by name."""
    del config
    return {"fig14-differences": _differences(table), "fig14-truth": _truth(table)}


def _differences(table: pd.DataFrame) -> Figure:
    def draw_panel(panel: Axes, axis: str) -> None:
        row = next(r for r in article_results() if r.axis == axis)
        panel.axhspan(*row.span, **style.ARTICLE_BAND, label="article's range")
        for shift, (pair, look) in zip((-0.15, 0.15), _PAIRS.items(), strict=True):
            _whiskers(panel, absolute_differences_mm(table, "gaze", axis, pair), shift, **look)
        panel.set_ylabel(f"|gaze - pair| in {axis} [mm]")

    draws = len(fix_errors_mm(table, "pair", "z"))
    return _by_axis(draw_panel, f"median and middle 80 % of {draws} draws")


def _truth(table: pd.DataFrame) -> Figure:
    def draw_panel(panel: Axes, axis: str) -> None:
        for shift, (method, look) in zip((-0.22, 0.0, 0.22), _METHODS.items(), strict=True):
            _whiskers(panel, fix_errors_mm(table, method, axis), shift, **look)
        panel.set_ylabel(f"|error in {axis}| [mm]")

    return _by_axis(draw_panel, "against the truth, which the article did not have")


def _by_axis(draw_panel: Callable[[Axes, str], None], title: str) -> Figure:
    """A figure with a panel per axis, over the points of Table 7."""
    figure = style.new_figure(9.6, 4.2)
    for axis, panel in zip(AXES, figure.subplots(1, 3), strict=True):
        draw_panel(panel, axis)
        panel.set_xlabel("point of Table 7")
        panel.set_xticks(range(1, 9))
        panel.set_ylim(bottom=0.0)
    style.legend_below(figure, 3, title=title)
    return figure


def _whiskers(panel: Axes, values: FloatArray, shift: float, **look: Any) -> None:
    """Median and middle 80 % of the draws at each point."""
    low, median, high = np.percentile(np.abs(values), [10.0, 50.0, 90.0], axis=0)
    panel.errorbar(
        np.arange(1, values.shape[1] + 1) + shift, median, yerr=[median - low, high - median],
        linestyle="none", capsize=3, markersize=6, elinewidth=1.3, **look,
    )  # fmt: skip


EXPERIMENT: Final = Experiment(
    name="fixed-pair", title="Against a fixed stereo pair",
    article="Section 5.2, Tables 6 and 7, Figure 14",
    text=read_template(__package__, "sections/fixed_pair.jinja"), config=FixedPairConfig,
    quick={"heads": 40, "samples": 60, "noise_poses": 2, "noise_frames": 10},
    run=run, summarise=summarise, numbers=numbers, draw=draw,
)  # fmt: skip
