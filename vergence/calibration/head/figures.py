"""Figures of a head's calibration: residuals, coverage, angles, correlations, depth errors."""

from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import LogLocator, MaxNLocator
from numpy.typing import NDArray

from vergence.calibration.head.calibrate_head import HeadCalibration
from vergence.calibration.head.depth import points_ahead, points_at_angles, predict_depth_errors
from vergence.calibration.image_figures import (
    CAMERA_FIGURE_WIDTH,
    EYE_STYLES,
    draw_corner_coverage,
    draw_residual_arrows,
    thinning_slice,
)
from vergence.models.parts import EYE_NAMES, NECK, FloatArray
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
from vergence.reporting.text import format_fixed

_PAGE_WIDTH: Final = 11.2
"""Width of a figure across the page, inches (chosen)."""
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
_DISTANCES_M: Final = (0.3, 3.0)
"""Range of distances of the figures, m (chosen: the range of use)."""
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
        figure = new_figure(_PAGE_WIDTH, 4.6)
        for eye, panel in enumerate(figure.subplots(2, 1, sharex=True)):
            kept = np.flatnonzero(calibration.kept_views[eye])
            kept = kept[thinning_slice(len(kept))]
            out = ~np.isnan(rms[eye]) & ~calibration.kept_views[eye]
            styles: tuple[tuple[NDArray[np.intp], FloatArray, str, dict[str, Any]], ...] = (
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


def residuals_px(calibration: HeadCalibration) -> FloatArray:
    """(2, f, n, 2) residuals projected minus measured, px; nan for corners that were not kept."""
    left = calibration.solution.normal.residuals * calibration.frames.sigma
    return np.where(calibration.kept_corners[..., None], left, np.nan)


def corner_coverage(calibration: HeadCalibration, eye: int) -> Figure:
    """Draw the kept corners over an eye's image."""
    views = np.where(
        calibration.kept_corners[eye][..., None], calibration.frames.pixels[eye], np.nan
    )
    return draw_corner_coverage(
        views, _size(calibration, eye), EYE_NAMES[eye], EYE_STYLES[eye]["color"]
    )


def residual_field(calibration: HeadCalibration, eye: int) -> Figure:
    """Draw residuals over an eye's image as magnified arrows."""
    kept = calibration.kept_corners[eye]
    return draw_residual_arrows(
        calibration.frames.pixels[eye][kept], residuals_px(calibration)[eye][kept],
        _size(calibration, eye), EYE_NAMES[eye],
    )  # fmt: skip


def _size(calibration: HeadCalibration, eye: int) -> tuple[int, int]:
    width, height = calibration.nominal_head.cameras.size[eye].tolist()
    return int(width), int(height)


def actuator_names(calibration: HeadCalibration) -> list[str]:
    """List the names of the neck's joints and the eyes' actuators; empty for missing ones."""
    nominal_head = calibration.nominal_head
    names = [*nominal_head.joints[NECK], *nominal_head.actuation.names]
    return names + [""] * (7 - len(names))


def joint_angle_coverage(calibration: HeadCalibration) -> Figure:
    """Plot the angles of all actuators between their limits, and both eyes' joint angles."""
    nominal_head, own = calibration.nominal_head, calibration.nominal_head.actuation
    used = np.flatnonzero(calibration.kept_views.any(axis=0))
    _, first = np.unique(calibration.frames.pose[used], return_index=True)
    q = calibration.frames.joint_positions[used[first]]
    angles, limits = np.degrees(own.actuators_of(q)), np.degrees([own.lower, own.upper])
    moves = [
        k
        for k, name in enumerate(actuator_names(calibration))
        if name and own.upper[k] > own.lower[k]
    ]
    with figure_style():
        figure = new_figure(_PAGE_WIDTH, 4.6)
        strips, eyes = figure.subplots(1, 2, width_ratios=(1.4, 1.0))
        # dots one below the other in the order of the recording
        height = np.linspace(-0.32, 0.32, len(q)) if len(q) > 1 else np.zeros(1)
        for row, k in enumerate(moves):
            low, high = limits[:, k]
            strips.add_patch(Rectangle((low, row - 0.38), high - low, 0.76, fc="#e8e8ec", lw=0.0))
            colour = GREEN if k < NECK.stop else BLUE
            strips.plot(angles[:, k], row + height, ".", ms=5, mew=0, color=colour)
        strips.set_yticks(range(len(moves)), [actuator_names(calibration)[k] for k in moves])
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
        eyes.set(
            xlabel=f"{_common(nominal_head.joints[3 + right], nominal_head.joints[5 + right])} (°)",
            ylabel=f"{_common(nominal_head.joints[3 + down], nominal_head.joints[5 + down])} (°)",
            title="both eyes' joints",
        )  # fmt: skip
        eyes.set_aspect("equal", adjustable="datalim")
        legend_below(eyes, 2, fontsize=10)
    return figure


def _tilt_and_pan(names: tuple[str, ...]) -> tuple[int, int]:
    """Choose the eye joints for the vertical and the horizontal axis of the figure."""
    return (1, 0) if "pan" in names[0] and "pan" not in names[1] else (0, 1)


def _common(left: str, right: str) -> str:
    return left if left == right else f"{left}, {right}"


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
    with figure_style():
        figure = new_figure(_PAGE_WIDTH, 2.2 + 0.3 * count)
        panel = figure.add_subplot()
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
    for k, name in enumerate(actuator_names(calibration)):
        single = own[:, k] & determined[:, k] & calibration.kept_views.any(axis=0)
        if single.any():
            errors[name] = calibration.solution.state.frame_errors[single, k]
    return errors


def reading_error_histograms(calibration: HeadCalibration) -> Figure:
    """Draw histograms of reading errors by actuator, with the uniform density of quantisation."""
    errors, names = determined_reading_errors(calibration), actuator_names(calibration)
    columns = min(len(errors), 4)
    rows = -(-len(errors) // columns)
    with figure_style():
        figure = new_figure(_PAGE_WIDTH, 0.4 + 2.3 * rows)
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
    depth = predict_depth_errors(calibration, points_ahead(np.geomspace(*_DISTANCES_M, 60)))
    lines: tuple[tuple[FloatArray, str, dict[str, Any]], ...] = (
        (
            np.abs(depth.nominal_error_m),
            "before: by the file",
            {"color": ORANGE, "linestyle": "--"},
        ),
        (depth.sigma_m, "after: one sigma", {"color": BLUE, "linestyle": "-"}),
        (depth.noise_floor_m, "one fixation's own noise", {"color": GREY, "linestyle": ":"}),
    )
    with figure_style():
        figure = new_figure(CAMERA_FIGURE_WIDTH, 4.4)
        panel = figure.add_subplot()
        for values, label, style in lines:
            panel.loglog(depth.distance_m, 1e3 * values, label=label, **style)
        panel.set(xlabel="distance straight ahead (m)", ylabel="error of depth (mm)")
        panel.set_xticks([0.3, 0.5, 1.0, 2.0, 3.0], minor=False)
        panel.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        for axis in (panel.xaxis, panel.yaxis):
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter("")
        panel.set_xlim(*_DISTANCES_M)
        legend_below(figure, 2, fontsize=10)
    return figure


def depth_error_map_points(distance_m: float) -> FloatArray:
    """(n, 3) points of a map, m, row by row from above, relative to midway between the eyes."""
    right, down = np.meshgrid(np.radians(_ANGLES_DEG), np.radians(_ANGLES_DEG))
    return points_at_angles(distance_m, right.ravel(), down.ravel())


def depth_error_maps(calibration: HeadCalibration, distance_m: float) -> Figure:
    """Draw maps of depth errors by direction, before and after, in percent of the distance."""
    depth = predict_depth_errors(calibration, depth_error_map_points(distance_m))
    with figure_style():
        figure = new_figure(_PAGE_WIDTH, 5.0)
        before, after = figure.subplots(1, 2)
        _table(
            before,
            depth.nominal_error_percent,
            f"before, at {distance_m:g} m: error (%)",
            signed=True,
        )
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
