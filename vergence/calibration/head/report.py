"""Calibration of a head from one recording as a job, and its run folder: head file, tables, report.

A job runs in this process, in another one, or on a cluster.
"""

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from vergence.calibration.adjustment import rms_length
from vergence.calibration.head.calibrate import (
    HeadCalibration,
    actuator_names,
    calibrate_head,
    points_at_angles,
    predict_depth_errors,
)
from vergence.calibration.head.fit import masked_mean
from vergence.calibration.head.judge import UnobservableDirection, unobservable_directions
from vergence.calibration.head.recording import LEAST_CORNERS, HeadRecording
from vergence.calibration.report import (
    EYE_STYLES,
    PAGE_WIDTH,
    draw_by_distance,
    draw_corner_coverage,
    draw_matrix,
    draw_residual_arrows,
    panels,
    residual_limit,
    thinning_slice,
    write_csv,
    write_page,
)
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.head_file import check_head_name, head_to_toml
from vergence.models.parts import EYE_NAMES, NECK, CalibrationRecord, FloatArray
from vergence.operands import null_nonfinite_elements, null_nonfinite_rows
from vergence.reporting.runs import package_versions, write_json
from vergence.reporting.style import BLACK, BLUE, GREEN, GREY, ORANGE, legend_below
from vergence.reporting.text import format_fixed, format_number

_TABLE_DISTANCES_M: Final = (0.3, 0.5, 1.0, 2.0, 2.5, 3.0)
"""Distances of the table of depth, m (chosen: the range of use)."""
_SUMMARY_DISTANCES_M: Final = (0.5, 1.0, 2.5)
"""Distances of the summary at the top of the report, m (chosen among `_TABLE_DISTANCES_M`)."""
_MAP_DISTANCES_M: Final = (1.0, 2.5)
"""Distances of the maps of depth errors, m (chosen)."""
_UNIT_FORMATS: Final[dict[str, tuple[float, str, int]]] = {
    "rad": (180.0 / np.pi, " (°)", 4),
    "m": (1e3, " (mm)", 3),
    "px": (1.0, " (px)", 2),
    "1": (1.0, "", 5),
}
"""Format of each unit in the table of parameters: factor, name, and digits."""
_MOST_ROWS: Final = 40
"""Most rows of the table of views left out (chosen: a page's worth; the rest is in views.csv)."""
_RECORDED_PACKAGES: Final = ("vergence", "numpy", "scipy", "opencv-python-headless")
_REPLACED_ASSUMPTIONS: Final = (
    "links", "eyes", "joints.origin_m", "joints.rpy_rad", "joints.axis", "joints.alpha_rad",
    "joints.a_m", "joints.d_m", "joints.offset_rad", "frame",
)  # fmt: skip
"""Prefixes of the keys of assumptions that a calibration replaces by estimates."""


@dataclass(frozen=True, kw_only=True)
class HeadOutcome:
    """Result of a calibration job."""

    head_file: str = ""
    """Text of the head file; empty if the recording was refused."""
    document: Mapping[str, Any] = field(default_factory=dict)
    files: Mapping[str, bytes] = field(default_factory=dict)
    """The run folder's files by name."""
    refusal: str = ""
    """Reason of a refusal; empty if there is a head."""


@dataclass(frozen=True, kw_only=True)
class HeadJob:
    """The calibration of a head from one recording, see `calibrate_head`."""

    head: HeadModel
    recording: HeadRecording
    estimate_cameras: bool
    terms: tuple[str, ...]
    name: str
    """Name of the calibrated head."""
    head_file_name: str
    recording_path: str

    def __call__(self, progress: Callable[[float], None] | None = None) -> HeadOutcome:
        """Calibrate the head and make its files."""
        recorded = self.recording
        try:
            found = calibrate_head(
                self.head, recorded.frames, estimate_cameras=self.estimate_cameras,
                terms=self.terms, progress=progress,
            )  # fmt: skip
        except ConfigurationError as error:
            return HeadOutcome(refusal=str(error))
        text = head_file_text(found, recorded.sha256, self.name)
        told = result_document(found, unobservable_directions(found.solution))
        provenance = {
            "recording": self.recording_path,
            "files": ", ".join(recorded.files),
            "target": str(recorded.frames.target),
            "sha256": recorded.sha256,
        }
        with tempfile.TemporaryDirectory(prefix="vergence-") as folder:
            write_run(Path(folder), found, told, text, self.head_file_name, provenance)
            files = {each.name: each.read_bytes() for each in Path(folder).iterdir()}
        told |= {
            "recording": self.recording_path,
            "remarks": [*recorded.remarks, *found.remarks],
            "not_read": list(recorded.read_errors),
        }
        return HeadOutcome(head_file=text, document=told, files=files)


def head_file_text(calibration: HeadCalibration, sha256: str, name: str) -> str:
    """TOML text of a calibrated head, with origin (`sha256` of measurements) and uncertainty."""
    check_head_name(name)
    free = calibration.solution.problem.prior_sigma > 0.0
    names = np.array(calibration.nominal_head.parameters().names)[free]
    record = CalibrationRecord(
        target=str(calibration.frames.target),
        views=int(calibration.kept_views.sum()),
        rms_px=calibration.rms_px,
        rms_heldout_px=calibration.rms_heldout_px,
        corners_sha256=sha256,
        versions=", ".join(map(" ".join, package_versions(_RECORDED_PACKAGES).items())),
        sigma=dict(zip(names.tolist(), calibration.sigma[free].tolist(), strict=True)),
    )
    assumptions = {
        key: why
        for key, why in calibration.nominal_head.assumptions.items()
        if not key.startswith(_REPLACED_ASSUMPTIONS)
    }
    return head_to_toml(
        replace(calibration.head, name=name, assumptions=assumptions, calibration=record)
    )


def write_run(
    folder: Path, calibration: HeadCalibration, told: Mapping[str, Any], head_file_text: str,
    head_file_name: str, provenance: Mapping[str, str],
) -> None:  # fmt: skip
    """Write a calibration's head file, its tables and its report, see `result_document`."""
    (folder / head_file_name).write_text(head_file_text, encoding="utf-8")
    names, units, before = calibration.nominal_head.parameters()
    own = calibration.solution.problem
    noisier = zip(actuator_names(calibration.nominal_head), own.scatter_ratio.tolist(), strict=True)
    left_out = left_out_views(calibration)
    write_json(
        folder / "result.json",
        {
            **told,
            "left_out_views": left_out,
            "recording": dict(provenance),
            "noisier": {each: times for each, times in noisier if each},
            "names": list(names),
            "units": list(units),
            "before": before.tolist(),
            "after": calibration.solution.state.head_parameters.tolist(),
            "sigma": calibration.sigma.tolist(),
            "believed_sigma": own.prior_sigma.tolist(),
            "covariance": calibration.covariance.tolist(),
            "versions": package_versions(),
        },
    )
    write_csv(folder / "views.csv", _view_columns(calibration))
    write_page(
        folder, "head/head.html.jinja", _figures(calibration), **told,
        head=calibration.nominal_head.name, name=head_file_name, provenance=provenance,
        # distance, error before, and deviation after, for distances that the eyes reach
        headline=[
            (
                f"{row['distance_m']:g}", format_number(abs(row["before_mm"])),
                format_number(row["after_sigma_mm"]),
            )
            for row in told["depth"]
            if row["distance_m"] in _SUMMARY_DISTANCES_M
            and None not in (row["before_mm"], row["after_sigma_mm"])
        ],
        sides=EYE_NAMES, side="eye",
        maps=[f"{each:g}" for each in _MAP_DISTANCES_M],
        dropped=[
            [f"{one['time_s']:.2f} s, {one['eye']}", one["why"]] for one in left_out[:_MOST_ROWS]
        ],
        numbers=_number_rows(calibration),
    )  # fmt: skip


def result_document(
    calibration: HeadCalibration, unobservable: Sequence[UnobservableDirection]
) -> dict[str, Any]:
    """Convert the result to plain values for JSON."""
    depth = predict_depth_errors(calibration, points_at_angles(np.array(_TABLE_DISTANCES_M)))
    table = {
        "distance_m": depth.distance_m,
        "before_mm": 1e3 * depth.nominal_error_m,
        "before_vector_mm": 1e3 * depth.nominal_error_norm_m,
        "before_percent": depth.percent(depth.nominal_error_m),
        "after_sigma_mm": 1e3 * depth.sigma_m,
        "after_percent": depth.percent(depth.sigma_m),
        "floor_mm": 1e3 * depth.noise_floor_m,
    }
    rows = zip(*(null_nonfinite_elements(values) for values in table.values()), strict=True)
    frames, views = calibration.frames, calibration.frames.seen.any(axis=-1)
    held_out = calibration.held_out_mean_squares
    held_out = held_out[np.isfinite(held_out)]
    rms_held_out = float(np.sqrt(np.mean(held_out))) if len(held_out) else float("nan")
    return {
        "depth": [dict(zip(table, row, strict=True)) for row in rows],
        "noise": calibration.solution.reduced_chi,
        "rms_px": rms_length(
            np.where(calibration.kept_corners[..., None], calibration.residuals_px, np.nan)
        ),
        "rms_heldout_sigma": null_nonfinite_rows(rms_held_out),
        "views": int(calibration.kept_views.sum()),
        "left_out": int((views & ~calibration.kept_views).sum()),
        "frames": len(frames.time_s),
        "poses": int(frames.pose.max()) + 1,
        "placements": int(frames.placement.max()) + 1,
        "target": str(frames.target),
        "terms": [each._asdict() for each in calibration.terms],
        "unseen": [each._asdict() for each in unobservable],
        "remarks": list(calibration.remarks),
    }


def left_out_views(calibration: HeadCalibration) -> list[dict[str, Any]]:
    """List the views that show corners and were left out, in the order of time."""
    frames, residuals = calibration.frames, normalised_view_rms(calibration)
    usual = float(np.median(residuals[calibration.kept_views]))
    count = frames.seen.sum(axis=-1)

    def why(eye: int, frame: int) -> str:
        left = float(residuals[eye, frame])
        if count[eye, frame] < LEAST_CORNERS:
            return f"{count[eye, frame]} corners, where {LEAST_CORNERS} are needed"
        if np.isinf(left):
            return "its board belongs behind the camera"
        if left > usual:
            return f"{left:.3g} times sigma, where others leave {usual:.2g}"
        return "an angle that was read wrong"

    lost = np.argwhere((count > 0).T & ~calibration.kept_views.T)
    return [
        {"time_s": float(frames.time_s[frame]), "eye": EYE_NAMES[eye], "why": why(eye, frame)}
        for frame, eye in lost.tolist()
    ]


def _view_columns(calibration: HeadCalibration) -> dict[str, Sequence[object]]:
    """Make columns with a row for each frame and eye; None for missing numbers."""
    frames, residuals = calibration.frames, calibration.residuals_px
    counted, count = kept_or_found_corners(calibration), len(calibration.frames.time_s)
    rms_px = np.full((count, 2), np.nan)
    for frame, eye in np.argwhere(counted.any(axis=-1).T):
        squares = (residuals[eye, frame][counted[eye, frame]] ** 2).sum(axis=-1)
        rms_px[frame, eye] = np.sqrt(squares.mean())
    held_out = np.sqrt(calibration.held_out_mean_squares.T.ravel())
    return {
        "time_s": np.repeat(frames.time_s, 2).tolist(),
        "pose": np.repeat(frames.pose, 2).tolist(),
        "placement": np.repeat(frames.placement, 2).tolist(),
        "eye": EYE_NAMES * count,
        "kept": calibration.kept_views.T.ravel().tolist(),
        "corners": counted.sum(axis=-1).T.ravel().tolist(),
        "rms_px": null_nonfinite_elements(rms_px.ravel()),
        "rms_heldout_sigma": null_nonfinite_elements(held_out),
    }


def _figures(calibration: HeadCalibration) -> dict[str, Figure]:
    """Draw all figures, by name."""
    drawn: dict[str, Figure | None] = {
        "depth": depth_error_by_distance(calibration),
        "views": residuals_over_time(calibration),
        "joints": joint_angle_coverage(calibration),
    }
    for distance in _MAP_DISTANCES_M:
        drawn[f"map-{distance:g}"] = depth_error_maps(calibration, distance)
    for eye, name in enumerate(EYE_NAMES):
        width, height = calibration.nominal_head.cameras.size[eye].tolist()
        image, kept = ((int(width), int(height)), name), calibration.kept_corners[eye]
        pixels, residuals = calibration.frames.pixels[eye], calibration.residuals_px[eye]
        drawn[f"residuals-{name}"] = draw_residual_arrows(pixels[kept], residuals[kept], *image)
        views = np.where(kept[..., None], pixels, np.nan)
        drawn[f"coverage-{name}"] = draw_corner_coverage(views, *image, EYE_STYLES[eye]["color"])
    drawn["readings"] = reading_error_histograms(calibration)
    drawn["correlations"] = parameter_correlations(calibration)
    return {name: figure for name, figure in drawn.items() if figure is not None}


def _number_rows(calibration: HeadCalibration) -> list[list[str]]:
    """Format the rows of the table of head parameters."""
    own, rows = calibration.solution.problem, []
    for name, unit, before, after, sigma, spread in zip(
        *calibration.nominal_head.parameters()[:2], own.prior_mean.tolist(),
        calibration.solution.state.head_parameters.tolist(), calibration.sigma.tolist(),
        own.prior_sigma.tolist(), strict=True,
    ):  # fmt: skip
        scale, said, digits = _UNIT_FORMATS[unit]
        free = spread > 0.0
        rows.append(
            [
                name + said,
                format_fixed(scale * before, digits),
                format_fixed(scale * after, digits),
                format_fixed(scale * sigma if free else None, digits),
                format_fixed((after - before) / spread if free else None, 2, signed=True),
            ]
        )
    return rows


_AXIS_LIMIT_MEDIANS: Final = 2.5
"""Range of a residual axis in medians of the kept views, unless a kept view exceeds it (chosen)."""
_STRONG_CORRELATION: Final = 0.9
"""Absolute correlation from which on two parameters are hardly separable (chosen)."""
_MOST_PARAMETERS: Final = 24
"""Most parameters in a correlation matrix (chosen: more are unreadable)."""
_MOST_VARIANCE_RATIO: Final = 0.5
"""Ratio of posterior to prior variance of a reading error below which images determine it
(chosen)."""
_BIN_COUNT_RANGE: Final = (6, 30)
"""Fewest and most bins of a histogram, which grow with the readings (chosen)."""
_DISTANCE_TICKS_M: Final = (0.3, 0.5, 1.0, 2.0, 3.0)
"""Ticks of distances in figures, from the least to the largest, m (chosen: the range of use)."""
_ANGLES_DEG: Final = np.arange(-30.0, 31.0, 10.0)
"""Angles of a map to either side, and up and down, degrees (chosen)."""


def residuals_over_time(calibration: HeadCalibration) -> Figure:
    """Plot each view's residuals over time, also those by heads calibrated without it."""
    rms, kept_views = normalised_view_rms(calibration), calibration.kept_views
    held_out = np.sqrt(calibration.held_out_mean_squares)
    limit = residual_limit(rms[kept_views], _AXIS_LIMIT_MEDIANS)
    with panels(PAGE_WIDTH, 4.6, 2, 1, sharex=True) as (figure, both):
        for eye, panel in enumerate(both):
            kept = np.flatnonzero(kept_views[eye])
            kept = kept[thinning_slice(len(kept))]
            out = np.flatnonzero(~np.isnan(rms[eye]) & ~kept_views[eye])
            for at, values, label, style in (
                (kept, held_out, "by heads that did not know it",
                 {"marker": "o", "ms": 6.5, "mfc": "none", "mec": GREY, "mew": 0.8}),
                (kept, rms, "kept", {**EYE_STYLES[eye], "marker": "o", "ms": 3.5, "mew": 0}),
                (out, rms, "left out, at the edge if more",
                 {"marker": "x", "color": BLACK, "ms": 6, "mew": 1.4}),
            ):  # fmt: skip
                shown = np.minimum(values[eye, at], 0.96 * limit)
                time_s = calibration.frames.time_s[at]
                panel.plot(time_s, shown, linestyle="none", label=label, **style)
            panel.set(ylim=(0.0, limit), ylabel="rms / sigma", title=f"{EYE_NAMES[eye]} eye")
        legend_below(figure, 3, fontsize=10)
        panel.set_xlabel("time (s)")
    return figure


def normalised_view_rms(calibration: HeadCalibration) -> FloatArray:
    """(2, f) rms of kept corners (or all), in sigma; nan without corners, inf behind the camera."""
    counted = kept_or_found_corners(calibration)
    squares = np.nan_to_num(calibration.solution.squares, nan=np.inf)
    return np.asarray(np.sqrt(masked_mean(squares, counted)))


def kept_or_found_corners(calibration: HeadCalibration) -> NDArray[np.bool_]:
    """(2, f, n) True for the kept corners of each view, or for all found ones if none was kept."""
    return np.where(
        calibration.kept_views[..., None], calibration.kept_corners, calibration.frames.seen
    )


def joint_angle_coverage(calibration: HeadCalibration) -> Figure:
    """Plot the angles of all actuators between their limits, and both eyes' joint angles."""
    nominal_head, own = calibration.nominal_head, calibration.nominal_head.actuation
    used = np.flatnonzero(calibration.kept_views.any(axis=0))
    _, first = np.unique(calibration.frames.pose[used], return_index=True)
    q = calibration.frames.joint_positions[used[first]]
    angles, limits = np.degrees(own.actuators_of(q)), np.degrees([own.lower, own.upper])
    names = actuator_names(calibration.nominal_head)
    moves = [k for k, name in enumerate(names) if name and own.upper[k] > own.lower[k]]
    with panels(PAGE_WIDTH, 4.6, 1, 2, width_ratios=(1.4, 1.0)) as (figure, (strips, eyes)):
        # dots one below the other in the order of the recording
        height = np.linspace(-0.32, 0.32, len(q)) if len(q) > 1 else np.zeros(1)
        for row, k in enumerate(moves):
            low, high = limits[:, k]
            strips.add_patch(Rectangle((low, row - 0.38), high - low, 0.76, fc="#e8e8ec", lw=0.0))
            colour = GREEN if k < NECK.stop else BLUE
            strips.plot(angles[:, k], row + height, ".", ms=5, mew=0, color=colour)
        strips.set_yticks(range(len(moves)), [names[k] for k in moves])
        strips.set(
            ylim=(len(moves) - 0.5, -0.5), xlabel="angle (°)",
            title="each pose between the limits (grey)",
        )  # fmt: skip
        strips.grid(axis="y", visible=False)
        strips.tick_params(axis="y", length=0)
        strips.autoscale_view()
        for eye, name in enumerate(EYE_NAMES):
            down, right = np.degrees(q[:, _tilt_and_pan(nominal_head, eye)]).T
            style = {"linestyle": "none", "ms": 5, "mew": 0, "alpha": 0.8, **EYE_STYLES[eye]}
            eyes.plot(right, down, label=name, **style)
        down, right = _tilt_and_pan(nominal_head, 0)
        across, above = (
            ", ".join(dict.fromkeys(nominal_head.joints[joint] for joint in (own, own + 2)))
            for own in (right, down)
        )
        eyes.set(xlabel=f"{across} (°)", ylabel=f"{above} (°)", title="both eyes' joints")
        eyes.set_aspect("equal", adjustable="datalim")
        legend_below(eyes, 2, fontsize=10)
    return figure


def _tilt_and_pan(head: HeadModel, eye: int) -> list[int]:
    """Choose an eye's joints for the vertical and the horizontal axis of the figure."""
    first, second = 3 + 2 * eye, 4 + 2 * eye
    swapped = "pan" in head.joints[first] and "pan" not in head.joints[second]
    return [second, first] if swapped else [first, second]


def parameter_correlations(calibration: HeadCalibration) -> Figure | None:
    """Draw strong correlations between estimated parameters, the strongest if there are many."""
    free = np.flatnonzero(calibration.solution.problem.prior_sigma > 0.0)
    sigma = np.where(calibration.sigma > 0.0, calibration.sigma, 1.0)
    correlation = np.asarray(calibration.covariance / np.outer(sigma, sigma))
    others = np.abs(correlation[np.ix_(free, free)]) * (1.0 - np.eye(len(free)))
    best = others.max(axis=1, initial=0.0)
    chosen = np.argsort(-best, kind="stable")[:_MOST_PARAMETERS]
    chosen = np.sort(free[chosen[best[chosen] >= _STRONG_CORRELATION]])
    if not len(chosen):
        return None
    names = [calibration.nominal_head.parameters().names[k] for k in chosen]
    values = correlation[np.ix_(chosen, chosen)]
    strong = (np.abs(values) >= _STRONG_CORRELATION) & ~np.eye(len(chosen), dtype=bool)
    texts = np.where(strong, [[f"{100.0 * each:.0f}" for each in row] for row in values], "")
    with panels(PAGE_WIDTH, 2.2 + 0.3 * len(chosen)) as (figure, panel):
        image = draw_matrix(panel, values, texts, "PuOr", (-1.8, 1.8), 9)
        panel.set_xticks(range(len(chosen)), names, rotation=90, fontsize=10)
        panel.set_yticks(range(len(chosen)), names, fontsize=10)
        bar = figure.colorbar(image, ax=panel, shrink=0.6, label="correlation")
        bar.ax.set_ylim(-1.0, 1.0)
    return figure


def reading_error_histograms(calibration: HeadCalibration) -> Figure | None:
    """Draw histograms of the reading errors that images determine, and quantisation's density."""
    fit, names = calibration.solution, actuator_names(calibration.nominal_head)
    determined = fit.reading_variance_ratio < _MOST_VARIANCE_RATIO
    determined &= fit.problem.reading_error_unknowns.has_frame_error
    determined &= np.asarray(calibration.kept_views.any(axis=0))[:, None]
    errors = {
        name: fit.state.frame_errors[determined[:, k], k]
        for k, name in enumerate(names)
        if determined[:, k].any()
    }
    if not errors:
        return None
    columns = min(len(errors), 4)
    rows = -(-len(errors) // columns)
    with panels(PAGE_WIDTH, 0.4 + 2.3 * rows, rows, columns, squeeze=False) as (figure, grid):
        for panel in grid.ravel()[len(errors) :]:
            panel.set_axis_off()
        for panel, (name, values) in zip(grid.ravel(), errors.items(), strict=False):
            step = np.degrees(calibration.nominal_head.actuation.angle_step[names.index(name)])
            values = np.degrees(values)
            reach = 1.05 * max(float(np.abs(values).max()), 0.75 * step)
            bins = int(np.clip(1.5 * np.sqrt(len(values)), *_BIN_COUNT_RANGE))
            panel.hist(values, np.linspace(-reach, reach, bins + 1), density=True, color=BLUE)
            if step > 0.0:
                half, high = 0.5 * step, 1.0 / step
                panel.plot(
                    [-half, -half, half, half], [0.0, high, high, 0.0], "--", color=ORANGE, lw=1.6
                )
            panel.set(title=name, xlim=(-reach, reach), yticks=[])
            panel.set_xlabel("error (°)")
            panel.xaxis.set_major_locator(MaxNLocator(2, symmetric=True))
            panel.grid(False)
    return figure


def depth_error_by_distance(calibration: HeadCalibration) -> Figure:
    """Plot depth errors straight ahead: before, after, and the noise of a single fixation."""
    distance_m = np.geomspace(_DISTANCE_TICKS_M[0], _DISTANCE_TICKS_M[-1], 60)
    depth = predict_depth_errors(calibration, points_at_angles(distance_m))
    return draw_by_distance(
        depth.distance_m,
        (
            (1e3 * np.abs(depth.nominal_error_m), "before: by the file",
             {"color": ORANGE, "linestyle": "--"}),
            (1e3 * depth.sigma_m, "after: one sigma", {"color": BLUE, "linestyle": "-"}),
            (1e3 * depth.noise_floor_m, "one fixation's own noise",
             {"color": GREY, "linestyle": ":"}),
        ),
        ("distance straight ahead (m)", "error of depth (mm)"),
        ticks_m=_DISTANCE_TICKS_M, columns=2,
    )  # fmt: skip


def depth_error_maps(calibration: HeadCalibration, distance_m: float) -> Figure:
    """Draw maps of depth errors by direction, before and after, in percent of the distance."""
    right, down = np.meshgrid(np.radians(_ANGLES_DEG), np.radians(_ANGLES_DEG))
    points = points_at_angles(distance_m, right.ravel(), down.ravel())
    depth = predict_depth_errors(calibration, points)
    title = f"before, at {distance_m:g} m: error (%)"
    with panels(PAGE_WIDTH, 5.0, 1, 2) as (figure, (before, after)):
        _draw_map(before, depth.percent(depth.nominal_error_m), title, signed=True)
        title = f"after, at {distance_m:g} m: one sigma (%)"
        _draw_map(after, depth.percent(depth.sigma_m), title)
    return figure


def _draw_map(panel: Axes, percent: FloatArray, title: str, signed: bool = False) -> None:
    """Draw a table of numbers by direction; colours get darker away from 0."""
    count = len(_ANGLES_DEG)
    most = max(float(np.nanmax(np.abs(percent), initial=0.0)), 1e-9)
    digits = 2 if most >= 0.5 else 3
    texts = [
        format_fixed(each, digits, signed=signed) if np.isfinite(each) else ""
        for each in percent.tolist()
    ]
    draw_matrix(
        panel, percent.reshape(count, count), np.reshape(texts, (count, count)),
        "PuOr" if signed else "Blues", (-1.6 * most if signed else 0.0, 1.6 * most), 10,
        aspect="auto",
    )  # fmt: skip
    panel.set_facecolor("#dddddd")
    labels = [f"{angle:g}" for angle in np.abs(_ANGLES_DEG)]
    panel.set_xticks(range(count), labels)
    panel.set_yticks(range(count), labels)
    panel.set(xlabel="left    (°)    right", ylabel="down    (°)    up", title=title)
