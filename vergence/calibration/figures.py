"""Figures of a calibration's report."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Patch
from matplotlib.ticker import LogLocator
from scipy.spatial import ConvexHull, QhullError

from vergence.calibration.calibrate import Calibration
from vergence.calibration.coverage import (
    board_tilts,
    camera_names,
    direction_sigma_px_at,
    pixel_grid,
)
from vergence.calibration.depth import DepthSigma
from vergence.calibration.image_figures import (
    CAMERA_FIGURE_WIDTH,
    EYE_STYLES,
    LEAST_IN_CELL,
    draw_corner_coverage,
    draw_residual_arrows,
    new_image_figure,
    thinning_slice,
)
from vergence.models.parts import FloatArray
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

_PAGE_WIDTH: Final = 11.2
"""Width of a figure of all cameras, inches (chosen)."""
_RINGS: Final = 12
"""Rings of equal width around the principal point in which residuals are averaged (chosen)."""
_CONTOUR_GRID_COUNT: Final = 41
"""Pixels along each side of an image at which sigma is evaluated for contours (numerical)."""
_LEVELS_PX: Final = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
"""Levels of the contours of sigma, px (chosen)."""
_AXIS_LIMIT_MEDIANS: Final = 4.0
"""Largest bar in medians of the kept views, unless a kept view exceeds it (chosen)."""
_MOST_NAMED_VIEWS: Final = 40
"""Largest number of views that all have their names below the bars (chosen)."""


def residual_field(calibration: Calibration, camera: int) -> Figure:
    """Draw mean residuals over a camera's image as magnified arrows."""
    return draw_residual_arrows(
        *_residuals(calibration, camera),
        calibration.observations.image_sizes[camera],
        camera_names(calibration)[camera],
    )


def residuals_by_radius(calibration: Calibration, camera: int) -> Figure:
    """Plot radial and tangential residuals against the radius from the principal point."""
    pixels, residuals = _residuals(calibration, camera)
    out = pixels - calibration.rig.camera_parameters[camera][2:4]
    radius = np.linalg.norm(out, axis=-1)
    unit = out / np.maximum(radius, 1e-9)[:, None]
    along = (residuals * unit).sum(axis=-1)
    across = residuals[:, 1] * unit[:, 0] - residuals[:, 0] * unit[:, 1]
    edges = np.linspace(0.0, radius.max(), _RINGS + 1)
    ring = np.clip(np.digitize(radius, edges) - 1, 0, _RINGS - 1)
    with figure_style():
        figure = new_figure(CAMERA_FIGURE_WIDTH, 3.9)
        panel = figure.add_subplot()
        every = thinning_slice(len(radius))
        panel.plot(
            radius[every], along[every], ".", ms=4, color=GREY, alpha=0.4, mew=0, rasterized=True
        )
        for values, label, style in (
            (along, "outwards", EYE_STYLES[0]),
            (across, "around", {"color": ORANGE, "marker": "s", "linestyle": "--"}),
        ):
            rows = [
                (radius[ring == r].mean(), values[ring == r].mean(),
                 2.0 * values[ring == r].std() / np.sqrt((ring == r).sum()))
                for r in range(_RINGS) if (ring == r).sum() >= LEAST_IN_CELL
            ]  # fmt: skip
            at, mean, twice = np.array(rows).reshape(-1, 3).T
            panel.errorbar(at, mean, twice, capsize=2, label=f"mean {label}", **style)
        limit = 1.05 * float(np.quantile(np.abs(along), 0.99))
        panel.set(
            xlabel="radius from the principal point (px)", ylabel="residual (px)",
            ylim=(-limit, limit), title=camera_names(calibration)[camera],
        )  # fmt: skip
        legend_below(figure, 2, fontsize=10)
    return figure


def image_coverage(calibration: Calibration, camera: int) -> Figure:
    """Draw the corners used by the calibration over the image, and the views in each part of it."""
    views = calibration.fit.solution.problem.pixels[camera]
    size, name = calibration.observations.image_sizes[camera], camera_names(calibration)[camera]
    return draw_corner_coverage(views, size, name, EYE_STYLES[camera]["color"])


def tilt_directions(calibration: Calibration) -> Figure:
    """Plot direction and size of the board's tilts."""
    with figure_style():
        figure = new_figure(CAMERA_FIGURE_WIDTH, 5.2)
        panel = figure.add_subplot()
        most = 40.0
        for camera, name in enumerate(camera_names(calibration)):
            held = board_tilts(calibration, camera)
            panel.plot(*held.tilt_deg.T, label=name, **_dots(camera))
            most = max(most, 1.1 * float(held.angle_deg.max()))
        for ring in range(15, int(most), 15):
            panel.add_patch(Circle((0.0, 0.0), ring, fill=False, ec=GREY, lw=0.8, ls=":"))
            panel.text(
                0.0, -ring, f"{ring}°", ha="center", va="center", fontsize=10, color=GREY,
                bbox={"boxstyle": "round,pad=0.1", "fc": "white", "ec": "none"},
            )  # fmt: skip
        panel.grid(False)
        panel.axhline(0.0, color=GREY, lw=0.6)
        panel.axvline(0.0, color=GREY, lw=0.6)
        panel.set(
            xlim=(-most, most), ylim=(most, -most), aspect="equal",
            xlabel="left side nearer    tilt (°)    right side nearer",
            ylabel="lower edge nearer    upper edge nearer", title="tilt of each view's board",
        )  # fmt: skip
    return figure


def tilts_by_distance(calibration: Calibration) -> Figure:
    """Plot the tilt of the board in each view against its distance."""
    with figure_style():
        figure = new_figure(CAMERA_FIGURE_WIDTH, 5.2)
        panel = figure.add_subplot()
        for camera, name in enumerate(camera_names(calibration)):
            held = board_tilts(calibration, camera)
            panel.plot(held.distance_m, held.angle_deg, label=name, **_dots(camera))
        panel.set(
            xlabel="distance of the board's middle (m)", ylabel="tilt (°)",
            title="tilt and distance of each view's board",
        )  # fmt: skip
        panel.set_ylim(bottom=0.0)
        if len(calibration.single_fits) > 1:
            legend_below(figure, 2)
    return figure


def _dots(camera: int) -> dict[str, Any]:
    return {**EYE_STYLES[camera], "linestyle": "none", "ms": 6, "alpha": 0.75, "mew": 0}


def view_residuals(calibration: Calibration) -> Figure:
    """Plot the root mean square of each view's residuals; views left out are hatched."""
    fits = dict(zip(camera_names(calibration), calibration.single_fits, strict=True))
    colours = [EYE_STYLES[camera]["color"] for camera in range(len(fits))]
    if len(fits) > 1:
        fits["both together"] = calibration.fit
        colours.append(GREEN)
    bars = {
        name: np.where(np.isfinite(fit.views.reduced_chi), fit.views.rms_px, 0.0)
        for name, fit in fits.items()
    }
    good = np.concatenate([bars[name][fit.kept_views] for name, fit in fits.items()])
    limit = max(1.15 * float(good.max()), _AXIS_LIMIT_MEDIANS * float(np.median(good)))
    kept = calibration.fit.kept_views
    places, wide = np.arange(len(kept)), 0.8 / len(fits)
    with figure_style():
        figure = new_figure(_PAGE_WIDTH, 4.0)
        panel = figure.add_subplot()
        for number, (name, fit) in enumerate(fits.items()):
            at = places + wide * (number - 0.5 * (len(fits) - 1))
            colour = colours[number]
            drawn = panel.bar(at, np.minimum(bars[name], limit), wide, color=colour, label=name)
            for view in np.flatnonzero(~fit.kept_views).tolist():
                drawn[view].set(facecolor="white", edgecolor=colour, hatch="////", linewidth=0.8)
            for view in np.flatnonzero(bars[name] > limit).tolist():
                panel.text(
                    at[view], 1.01 * limit, f"{bars[name][view]:.1f}", ha="center", fontsize=9
                )
        for view in np.flatnonzero(~kept).tolist():
            panel.plot(view, -0.03 * limit, "x", color=BLACK, ms=6, mew=1.6, clip_on=False)
        panel.grid(axis="x", visible=False)
        panel.set_axisbelow(True)
        panel.set(xlim=(-0.7, len(kept) - 0.3), ylim=(0.0, 1.08 * limit), ylabel="rms (px)")
        labels = truncated_file_stems(calibration.observations.file_names[0])
        step = -(-len(kept) // _MOST_NAMED_VIEWS)
        panel.set_xticks(places[::step], labels[::step], rotation=90, fontsize=9)
        panel.tick_params(axis="x", length=0, pad=10)
        if len(fits) > 1:
            handles = [Patch(color=colour) for colour in colours]
            figure.legend(handles, list(fits), loc="outside upper center", ncols=3, fontsize=10)
    return figure


def direction_sigma(calibration: Calibration, camera: int) -> Figure:
    """Draw the standard deviation of directions over a camera's image, and the hull of corners."""
    width, height = calibration.observations.image_sizes[camera]
    grid = pixel_grid((width, height), _CONTOUR_GRID_COUNT)
    sigma = direction_sigma_px_at(calibration, camera, grid.reshape(-1, 2)).reshape(
        _CONTOUR_GRID_COUNT, _CONTOUR_GRID_COUNT
    )
    low, high = _LEVELS_PX[0], _LEVELS_PX[-1]
    shown = np.ma.masked_invalid(np.clip(sigma, 1.001 * low, 0.999 * high))
    pixels, _ = _residuals(calibration, camera)
    with figure_style():
        figure, panel = new_image_figure((width, height))
        panel.contourf(
            *grid.T.swapaxes(1, 2), shown, _LEVELS_PX, cmap="Blues", norm=LogNorm(low, 10.0 * high)
        )
        lines = panel.contour(
            *grid.T.swapaxes(1, 2), shown, _LEVELS_PX, colors=BLACK, linewidths=0.8
        )
        panel.clabel(lines, fmt="%g", fontsize=10)
        panel.set_facecolor("#bbbbbb")
        hull = _hull(pixels)
        panel.plot(*hull.T, "--", color=ORANGE, lw=2.0)
        panel.set_title(f"{camera_names(calibration)[camera]}, sigma of directions (px)")
    return figure


def depth_sigma(depth: DepthSigma, in_percent: bool) -> Figure:
    """Plot the standard deviation of depth: from calibration, from one pair's noise, from both."""
    scale = 1e2 / depth.distance_m if in_percent else np.full(len(depth.distance_m), 1e3)
    with figure_style():
        figure = new_figure(CAMERA_FIGURE_WIDTH, 4.4)
        panel = figure.add_subplot()
        for values, label, style in (
            (depth.calibration_m, "calibration", {"color": BLUE, "linestyle": "-"}),
            (depth.noise_m, "noise of one pair", {"color": ORANGE, "linestyle": "--"}),
            (depth.total_m, "both", {"color": BLACK, "linestyle": ":"}),
        ):
            panel.loglog(depth.distance_m, scale * values, label=label, **style)
        unit = "%" if in_percent else "mm"
        panel.set(xlabel="distance (m)", ylabel=f"sigma of depth ({unit})")
        for axis in (panel.xaxis, panel.yaxis):
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter("")
        legend_below(figure, 3, fontsize=10)
    return figure


def truncated_file_stems(names: Sequence[str]) -> list[str]:
    """Shorten file names: without folder and suffix, the last 16 characters."""
    return [name.replace("\\", "/").rsplit("/", 1)[-1].rsplit(".", 1)[0][-16:] for name in names]


def _residuals(calibration: Calibration, camera: int) -> tuple[FloatArray, FloatArray]:
    """(n, 2) measured corners of the kept views, and residuals projected minus measured, px."""
    solution = calibration.fit.solution
    seen = solution.problem.seen[camera]
    return solution.problem.pixels[camera][seen], solution.residuals_px[camera][seen]


def _hull(pixels: FloatArray) -> FloatArray:
    """Closed convex hull of pixels; the pixels themselves if they are collinear."""
    try:
        corners = ConvexHull(pixels).vertices
    except QhullError:
        return pixels
    return np.asarray(pixels[np.append(corners, corners[0])])
