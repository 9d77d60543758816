"""Figures of a calibrated head's depth errors."""

from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from vergence.calibration.head.calibrate_head import HeadCalibration
from vergence.calibration.head.depth import points_ahead, points_at_angles, predict_depth_errors
from vergence.calibration.image_figures import CAMERA_FIGURE_WIDTH
from vergence.eval.reporting.style import BLACK, BLUE, GREY, ORANGE, figure_style, new_figure
from vergence.eval.reporting.text import format_fixed
from vergence.models.parts import FloatArray

_PAGE_WIDTH: Final = 11.2
"""Width of a figure across the page, inches (chosen)."""
_DISTANCES_M: Final = (0.3, 3.0)
"""Range of distances of the figures, m (chosen: the range of use)."""
_ANGLES_DEG: Final = np.arange(-30.0, 31.0, 10.0)
"""Angles of a map to either side, and up and down, degrees (chosen)."""


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
        panel.legend(loc="upper left", fontsize=10)
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
