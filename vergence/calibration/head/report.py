"""Run folder of a calibrated head: head file, tables and HTML report."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from vergence.calibration.adjustment import rms_length
from vergence.calibration.head.calibrate import (
    HeadCalibration,
    actuator_names,
    points_ahead,
    points_at_angles,
    predict_depth_errors,
)
from vergence.calibration.head.judge import UnobservableDirection
from vergence.calibration.head.recording import LEAST_CORNERS
from vergence.calibration.report import (
    EYE_STYLES,
    PAGE_WIDTH,
    Line,
    draw_by_distance,
    draw_corner_coverage,
    draw_residual_arrows,
    single_panel,
    thinning_slice,
    write_csv,
    write_page,
)
from vergence.models.parts import EYE_NAMES, NECK, FloatArray
from vergence.operands import null_nonfinite_elements, null_nonfinite_rows
from vergence.reporting.runs import package_versions, write_json
from vergence.reporting.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    figure_style,
    legend_below,
    new_figure,
)
from vergence.reporting.text import format_fixed, format_number

DEPTHS_M: Final = (0.3, 0.5, 1.0, 2.0, 2.5, 3.0)
"""Distances of the table of depth, m (chosen: the range of use)."""
_SUMMARY_DISTANCES_M: Final = (0.5, 1.0, 2.5)
"""Distances of the summary at the top of the report, m (chosen)."""
_MAP_DISTANCES_M: Final = (1.0, 2.5)
"""Distances of the maps of depth errors, m (chosen)."""
_UNIT_FORMATS: Final[dict[str, tuple[float, str, int]]] = {
    "rad": (180.0 / np.pi, "°", 4),
    "m": (1e3, "mm", 3),
    "px": (1.0, "px", 2),
    "1": (1.0, "", 5),
}
"""Format of each unit in the table of parameters: factor, name, and digits."""


_VIEW_COLUMNS: Final = (
    "time_s", "pose", "placement", "eye", "kept", "corners", "rms_px", "rms_heldout_sigma"
)  # fmt: skip
_MOST_ROWS: Final = 40
"""Most rows of the table of views left out (chosen: a page's worth; the rest is in views.csv)."""


def write_run(
    folder: Path,
    calibration: HeadCalibration,
    unobservable: Sequence[UnobservableDirection],
    head_file_text: str,
    head_file_name: str,
    provenance: Mapping[str, str],
) -> None:
    """Write a calibration's head file, its tables and its report."""
    (folder / head_file_name).write_text(head_file_text, encoding="utf-8")
    names, units, before = calibration.nominal_head.parameters()
    own = calibration.solution.problem
    noisier = zip(actuator_names(calibration.nominal_head), own.scatter_ratio.tolist(), strict=True)
    told, left_out = result_document(calibration, unobservable), left_out_views(calibration)
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
    write_csv(folder / "views.csv", _VIEW_COLUMNS, _view_rows(calibration))
    write_page(
        folder, "head/head.html.jinja", _figures(calibration), **told,
        head=calibration.nominal_head.name, name=head_file_name, provenance=provenance,
        headline=_headline(calibration), sides=EYE_NAMES, side="eye",
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
    depth = predict_depth_errors(calibration, points_ahead(np.array(DEPTHS_M)))
    table = {
        "distance_m": depth.distance_m,
        "before_mm": 1e3 * depth.nominal_error_m,
        "before_vector_mm": 1e3 * depth.nominal_error_norm_m,
        "before_percent": depth.nominal_error_percent,
        "after_sigma_mm": 1e3 * depth.sigma_m,
        "after_percent": depth.sigma_percent,
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
        "unseen": [
            {"what": each.what, "cure": each.remedy, "cost": each.cost} for each in unobservable
        ],
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


def _view_rows(calibration: HeadCalibration) -> Iterator[list[object]]:
    """Make a row for each frame and eye; missing numbers are empty."""
    frames = calibration.frames
    residuals = calibration.residuals_px
    counted = kept_or_found_corners(calibration)
    held_out = np.sqrt(calibration.held_out_mean_squares)
    for frame, eye in np.ndindex(len(frames.time_s), 2):
        mine = counted[eye, frame]
        squares = (residuals[eye, frame][mine] ** 2).sum(axis=-1)
        left = np.sqrt(squares.mean()) if len(squares) else np.nan
        numbers = [float(left), float(held_out[eye, frame])]
        yield [
            repr(float(frames.time_s[frame])), int(frames.pose[frame]),
            int(frames.placement[frame]), EYE_NAMES[eye],
            bool(calibration.kept_views[eye, frame]), int(mine.sum()),
            *(repr(each) if np.isfinite(each) else "" for each in numbers),
        ]  # fmt: skip


def _headline(calibration: HeadCalibration) -> list[tuple[str, str, str]]:
    """Format distance, error before, and deviation after, for distances that the eyes reach."""
    depth = predict_depth_errors(calibration, points_ahead(np.array(_SUMMARY_DISTANCES_M)))
    rows = zip(_SUMMARY_DISTANCES_M, 1e3 * depth.nominal_error_m, 1e3 * depth.sigma_m, strict=True)
    return [
        (f"{distance:g}", format_number(abs(before)), format_number(after))
        for distance, before, after in rows
        if np.isfinite(before) and np.isfinite(after)
    ]


def _figures(calibration: HeadCalibration) -> dict[str, Figure]:
    """Draw all figures, by name."""
    drawn = {"depth": depth_error_by_distance(calibration)}
    for distance in _MAP_DISTANCES_M:
        drawn[f"map-{distance:g}"] = depth_error_maps(calibration, distance)
    drawn["views"] = residuals_over_time(calibration)
    for eye, name in enumerate(EYE_NAMES):
        drawn[f"residuals-{name}"] = residual_field(calibration, eye)
        drawn[f"coverage-{name}"] = corner_coverage(calibration, eye)
    drawn["joints"] = joint_angle_coverage(calibration)
    if determined_reading_errors(calibration):
        drawn["readings"] = reading_error_histograms(calibration)
    if len(correlated_parameters(calibration)):
        drawn["correlations"] = parameter_correlations(calibration)
    return drawn


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
                f"{name} ({said})" if said else name,
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
    rms = normalised_view_rms(calibration)
    held_out = np.sqrt(calibration.held_out_mean_squares)
    usual = rms[calibration.kept_views]
    limit = max(1.15 * float(usual.max()), _AXIS_LIMIT_MEDIANS * float(np.median(usual)))
    time = calibration.frames.time_s
    with figure_style():
        figure = new_figure(PAGE_WIDTH, 4.6)
        for eye, panel in enumerate(figure.subplots(2, 1, sharex=True)):
            kept = np.flatnonzero(calibration.kept_views[eye])
            kept = kept[thinning_slice(len(kept))]
            out = ~np.isnan(rms[eye]) & ~calibration.kept_views[eye]
            styles: tuple[tuple[NDArray[np.intp], *Line], ...] = (
                (kept, held_out, "by heads that did not know it",
                 {"marker": "o", "ms": 6.5, "mfc": "none", "mec": GREY, "mew": 0.8}),
                (kept, rms, "kept", {**EYE_STYLES[eye], "marker": "o", "ms": 3.5, "mew": 0}),
                (np.flatnonzero(out), rms, "left out, at the edge if more",
                 {"marker": "x", "color": BLACK, "ms": 6, "mew": 1.4}),
            )  # fmt: skip
            for at, values, label, style in styles:
                shown = np.minimum(values[eye, at], 0.96 * limit)
                panel.plot(time[at], shown, linestyle="none", label=label, **style)
            panel.set(ylim=(0.0, limit), ylabel="rms / sigma", title=f"{EYE_NAMES[eye]} eye")
        legend_below(figure, 3, fontsize=10)
        panel.set_xlabel("time (s)")
    return figure


def normalised_view_rms(calibration: HeadCalibration) -> FloatArray:
    """(2, f) rms of kept corners (or all), in sigma; nan without corners, inf behind the camera."""
    counted = kept_or_found_corners(calibration)
    squares = np.nan_to_num(calibration.solution.squares, nan=np.inf)
    total = np.where(counted, squares, 0.0).sum(axis=-1)
    count = counted.sum(axis=-1)
    mean = np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)
    return np.asarray(np.sqrt(mean))


def kept_or_found_corners(calibration: HeadCalibration) -> NDArray[np.bool_]:
    """(2, f, n) True for the kept corners of each view, or for all found ones if none was kept."""
    return np.where(
        calibration.kept_views[..., None], calibration.kept_corners, calibration.frames.seen
    )


def _image(calibration: HeadCalibration, eye: int) -> tuple[tuple[int, int], str]:
    """Size, px, and name of an eye's image."""
    width, height = calibration.nominal_head.cameras.size[eye].tolist()
    return (int(width), int(height)), EYE_NAMES[eye]


def corner_coverage(calibration: HeadCalibration, eye: int) -> Figure:
    """Draw the kept corners over an eye's image."""
    kept = calibration.kept_corners[eye][..., None]
    views = np.where(kept, calibration.frames.pixels[eye], np.nan)
    return draw_corner_coverage(views, *_image(calibration, eye), EYE_STYLES[eye]["color"])


def residual_field(calibration: HeadCalibration, eye: int) -> Figure:
    """Draw residuals over an eye's image as magnified arrows."""
    kept = calibration.kept_corners[eye]
    pixels, residuals = calibration.frames.pixels[eye][kept], calibration.residuals_px[eye][kept]
    return draw_residual_arrows(pixels, residuals, *_image(calibration, eye))


def joint_angle_coverage(calibration: HeadCalibration) -> Figure:
    """Plot the angles of all actuators between their limits, and both eyes' joint angles."""
    nominal_head, own = calibration.nominal_head, calibration.nominal_head.actuation
    used = np.flatnonzero(calibration.kept_views.any(axis=0))
    _, first = np.unique(calibration.frames.pose[used], return_index=True)
    q = calibration.frames.joint_positions[used[first]]
    angles, limits = np.degrees(own.actuators_of(q)), np.degrees([own.lower, own.upper])
    names = actuator_names(calibration.nominal_head)
    moves = [k for k, name in enumerate(names) if name and own.upper[k] > own.lower[k]]
    with figure_style():
        figure = new_figure(PAGE_WIDTH, 4.6)
        strips, eyes = figure.subplots(1, 2, width_ratios=(1.4, 1.0))
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
        joints = np.degrees(q[:, 3:])
        for eye, name in enumerate(EYE_NAMES):
            down, right = _tilt_and_pan(nominal_head.joints[3 + 2 * eye : 5 + 2 * eye])
            eyes.plot(
                joints[:, 2 * eye + right], joints[:, 2 * eye + down], linestyle="none", ms=5,
                mew=0, alpha=0.8, label=name, **EYE_STYLES[eye],
            )  # fmt: skip
        down, right = _tilt_and_pan(nominal_head.joints[3:5])
        across, above = (
            ", ".join(dict.fromkeys(nominal_head.joints[joint] for joint in (3 + own, 5 + own)))
            for own in (right, down)
        )
        eyes.set(xlabel=f"{across} (°)", ylabel=f"{above} (°)", title="both eyes' joints")
        eyes.set_aspect("equal", adjustable="datalim")
        legend_below(eyes, 2, fontsize=10)
    return figure


def _tilt_and_pan(names: tuple[str, ...]) -> tuple[int, int]:
    """Choose the eye joints for the vertical and the horizontal axis of the figure."""
    return (1, 0) if "pan" in names[0] and "pan" not in names[1] else (0, 1)


def correlated_parameters(calibration: HeadCalibration) -> NDArray[np.intp]:
    """Find the estimated parameters with strong correlations, the strongest if there are many."""
    free = np.flatnonzero(calibration.solution.problem.prior_sigma > 0.0)
    size = np.abs(_correlation(calibration)[np.ix_(free, free)])
    np.fill_diagonal(size, 0.0)
    best = size.max(axis=1, initial=0.0)
    chosen = np.argsort(-best, kind="stable")[:_MOST_PARAMETERS]
    return np.sort(free[chosen[best[chosen] >= _STRONG_CORRELATION]])


def _correlation(calibration: HeadCalibration) -> FloatArray:
    sigma = np.where(calibration.sigma > 0.0, calibration.sigma, 1.0)
    return np.asarray(calibration.covariance / np.outer(sigma, sigma))


def parameter_correlations(calibration: HeadCalibration) -> Figure:
    """Draw the correlations between parameters that the recording hardly separates."""
    chosen = correlated_parameters(calibration)
    names = [calibration.nominal_head.parameters().names[k] for k in chosen]
    values = _correlation(calibration)[np.ix_(chosen, chosen)]
    count = len(chosen)
    with single_panel(PAGE_WIDTH, 2.2 + 0.3 * count) as (figure, panel):
        image = panel.imshow(values, cmap="PuOr", norm=Normalize(-1.8, 1.8))
        for row, column in np.argwhere(
            (np.abs(values) >= _STRONG_CORRELATION) & ~np.eye(count, dtype=bool)
        ):
            panel.text(
                column, row, f"{100.0 * values[row, column]:.0f}", ha="center", va="center",
                fontsize=9, color=BLACK,
            )  # fmt: skip
        panel.set_xticks(range(count), names, rotation=90, fontsize=10)
        panel.set_yticks(range(count), names, fontsize=10)
        panel.tick_params(length=0)
        panel.grid(False)
        bar = figure.colorbar(image, ax=panel, shrink=0.6, label="correlation")
        bar.ax.set_ylim(-1.0, 1.0)
    return figure


def determined_reading_errors(calibration: HeadCalibration) -> dict[str, FloatArray]:
    """(n,) errors by actuator, rad, of readings whose variance the images at least halve."""
    own = calibration.solution.problem.reading_error_unknowns.has_frame_error
    determined = calibration.solution.reading_variance_ratio < _MOST_VARIANCE_RATIO
    errors = {}
    for k, name in enumerate(actuator_names(calibration.nominal_head)):
        single = own[:, k] & determined[:, k] & calibration.kept_views.any(axis=0)
        if single.any():
            errors[name] = calibration.solution.state.frame_errors[single, k]
    return errors


def reading_error_histograms(calibration: HeadCalibration) -> Figure:
    """Draw histograms of reading errors by actuator, with the uniform density of quantisation."""
    errors, names = determined_reading_errors(calibration), actuator_names(calibration.nominal_head)
    columns = min(len(errors), 4)
    rows = -(-len(errors) // columns)
    with figure_style():
        figure = new_figure(PAGE_WIDTH, 0.4 + 2.3 * rows)
        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        for panel in panels[len(errors) :]:
            panel.set_axis_off()
        for panel, (name, values) in zip(panels, errors.items(), strict=False):
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
    depth = predict_depth_errors(calibration, points_ahead(distance_m))
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
    with figure_style():
        figure = new_figure(PAGE_WIDTH, 5.0)
        before, after = figure.subplots(1, 2)
        title = f"before, at {distance_m:g} m: error (%)"
        _table(before, depth.nominal_error_percent, title, signed=True)
        _table(after, depth.sigma_percent, f"after, at {distance_m:g} m: one sigma (%)")
    return figure


def _table(panel: Axes, percent: FloatArray, title: str, signed: bool = False) -> None:
    """Draw a table of numbers by direction; colours get darker away from 0."""
    count = len(_ANGLES_DEG)
    grid = percent.reshape(count, count)
    most = max(float(np.nanmax(np.abs(grid), initial=0.0)), 1e-9)
    low = -most if signed else 0.0
    panel.imshow(
        np.ma.masked_invalid(grid), cmap="PuOr" if signed else "Blues",
        norm=Normalize(1.6 * low, 1.6 * most), aspect="auto",
    )  # fmt: skip
    panel.set_facecolor("#dddddd")
    digits = 2 if most >= 0.5 else 3
    for row, column in np.argwhere(np.isfinite(grid)).tolist():
        text = format_fixed(float(grid[row, column]), digits, signed=signed)
        panel.text(column, row, text, ha="center", va="center", fontsize=10, color=BLACK)
    labels = [f"{angle:g}" for angle in np.abs(_ANGLES_DEG)]
    panel.set_xticks(range(count), labels)
    panel.set_yticks(range(count), labels)
    panel.set(xlabel="left    (°)    right", ylabel="down    (°)    up", title=title)
    panel.tick_params(length=0)
    panel.grid(False)
