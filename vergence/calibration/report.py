"""Run folder of a calibration: camera file, tables and HTML report."""

import csv
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

import jinja2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Circle, Patch, Rectangle
from matplotlib.ticker import LogLocator
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from vergence.calibration.advice import (
    CELLS,
    advise_next_photographs,
    board_sag,
    board_tilts,
    direction_sigma_px_at,
    median_and_corner_sigma_px,
    pixel_grid,
    views_in_cells,
)
from vergence.calibration.calibrate import Calibration
from vergence.calibration.uncertainty import DepthSigma
from vergence.files import write_atomic
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.reporting.report import inline_svg
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
    svg_text,
)
from vergence.reporting.text import (
    format_fixed,
    format_number,
    jinja_environment,
    read_template,
)

_DEPTHS_M: Final = (0.5, 1.0, 2.0, 2.5)
"""Distances of the table of depth, m (chosen: the range of use)."""


def write_run(folder: Path, calibration: Calibration, file_text: str, file_name: str) -> None:
    """Write a calibration's file, its tables and its report."""
    (folder / file_name).write_text(file_text, encoding="utf-8")
    names = calibration.rig.names(EYE_NAMES[: len(calibration.single_fits)])
    told = {**calibration.document(), "advice": advise_next_photographs(calibration)}
    write_json(
        folder / "result.json",
        {
            **told,
            "lens_errors": dict(calibration.lens_errors),
            "numbers": dict(zip(names, calibration.rig.packed().tolist(), strict=True)),
            "sigma": dict(zip(names, calibration.sigma.tolist(), strict=True)),
            "covariance": calibration.covariance.tolist(),
        },
    )
    views = calibration.fit.views
    columns = {
        "view": [Path(path).name for path in calibration.observations.file_names[0]],
        "kept": calibration.fit.kept_views.tolist(),
        "rms_px": views.view_rms_px.tolist(),
        "noise": views.view_chi.tolist(),
    }
    write_csv(folder / "views.csv", columns)
    several, held = len(calibration.camera_names) > 1, board_tilts(calibration)[0]
    write_page(
        folder, "cameras.html.jinja", _figures(calibration), **told, name=file_name,
        calibration=calibration, several=several,
        head="two cameras" if several else "a camera",
        sides=calibration.camera_names, side="camera", remarks=calibration.read_errors,
        every=len(calibration.fit.kept_views), sag=board_sag(calibration),
        tilt_deg=np.quantile(held.angle_deg, [0.0, 0.5, 1.0]).tolist(),
        distance_m=[float(held.distance_m.min()), float(held.distance_m.max())],
        directions=[
            median_and_corner_sigma_px(calibration, camera)
            for camera in range(len(calibration.camera_names))
        ],
        depths=_depth_rows(calibration) if several else [],
        numbers=[
            [f"{camera} {label}", *(format_fixed(one, 2 if label[1] == "_" else 5) for one in pair)]
            for camera, label, *pair in calibration.camera_values
        ],
    )  # fmt: skip


def write_csv(path: Path, columns: Mapping[str, Sequence[object]]) -> None:
    """Write a table with a header; None is an empty field."""
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([columns, *zip(*columns.values(), strict=True)])


def write_page(folder: Path, template: str, figures: Mapping[str, Figure], **values: Any) -> None:
    """Write calibration.html, which is self-contained, from a template that extends the page's."""
    page = jinja_environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True,
        loader=jinja2.PackageLoader("vergence.calibration", "."),
    )  # fmt: skip
    text = page.get_template(template).render(
        markup={stem: inline_svg(svg_text(each), stem, stem) for stem, each in figures.items()},
        style=read_template("vergence.reporting", "page.css"),
        versions=package_versions(),
        **values,
    )
    write_atomic(folder / "calibration.html", text)


def _figures(calibration: Calibration) -> dict[str, Figure]:
    """Draw all figures, by name."""
    by_camera = {
        "residuals": residual_field, "radius": residuals_by_radius, "coverage": image_coverage,
        "directions": direction_sigma,
    }  # fmt: skip
    drawn = {
        f"{kind}-{name}": draw(calibration, camera)
        for camera, name in enumerate(calibration.camera_names)
        for kind, draw in by_camera.items()
    }
    drawn["tilts"] = tilt_directions(calibration)
    drawn["distances"] = tilts_by_distance(calibration)
    drawn["views"] = view_residuals(calibration)
    if len(calibration.single_fits) > 1:
        depth = calibration.depth_sigma_at(depths_to_plot_m(calibration))
        drawn["depth"] = depth_sigma(depth, in_percent=False)
        drawn["depth-relative"] = depth_sigma(depth, in_percent=True)
    return drawn


def _depth_rows(calibration: Calibration) -> list[list[str]]:
    """Format the rows of the depth table."""
    depth = calibration.depth_sigma_at(np.array(_DEPTHS_M))
    columns = [1e3 * depth.calibration_m, 1e3 * depth.noise_m, 1e3 * depth.total_m,
               1e2 * depth.total_m / depth.distance_m]  # fmt: skip
    return [
        [f"{distance:g} m", *map(format_number, row)]
        for distance, row in zip(_DEPTHS_M, np.column_stack(columns).tolist(), strict=True)
    ]


Line = tuple[FloatArray, str, dict[str, Any]]
"""Values, label and style of a line in a figure."""
CAMERA_FIGURE_WIDTH: Final = 5.6
"""Width of a figure of one camera, inches (chosen: two stand side by side, one fills a phone)."""
EYE_STYLES: Final[tuple[dict[str, Any], ...]] = (
    {"color": BLUE, "marker": "o"},
    {"color": ORANGE, "marker": "s"},
)
LEAST_IN_CELL: Final = 3
"""Fewest corners whose mean residual is shown (chosen: a mean of fewer is mostly noise)."""
_CELLS_ACROSS: Final = 14
"""Cells across an image in which residuals are averaged (chosen)."""
_LONG_ARROW_CELLS: Final = 1.0
"""Length of a long mean arrow (90th percentile), in cells (chosen: arrows hardly overlap)."""
_MARGINS_IN: Final = (0.7, 0.85)
"""Width and height of a figure beside its image, inches (measured: labels and title)."""
_MOST_DOTS: Final = 4000
"""Most dots of a scatter plot (chosen: more only fill the page with ink)."""


def draw_residual_arrows(
    pixels: FloatArray, residuals: FloatArray, size: tuple[int, int], name: str
) -> Figure:
    """Draw corners over an image, and arrows of their mean residuals in cells."""
    cell = size[0] / _CELLS_ACROSS
    keys = np.floor((pixels + 0.5) / cell).astype(int)
    cells, which, count = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    mean = np.zeros((len(cells), 2))
    np.add.at(mean, which.ravel(), residuals)
    full = count >= LEAST_IN_CELL
    mean = mean[full] / count[full, None]
    places = (cells[full] + 0.5) * cell - 0.5
    lengths = np.linalg.norm(mean, axis=-1)
    long = max(float(np.quantile(lengths, 0.9)), 1e-6) if len(lengths) else 1.0
    with image_panel(size) as (figure, panel):
        panel.plot(
            *pixels[thinning_slice(len(pixels))].T, ".", ms=3, mew=0, alpha=0.4, color=GREY,
            rasterized=True,
        )  # fmt: skip
        arrows = panel.quiver(
            *places.T, *mean.T, color=BLACK, width=0.006, headwidth=3.5, angles="xy",
            scale_units="xy", scale=long / (_LONG_ARROW_CELLS * cell),
        )  # fmt: skip
        key = float(f"{long:.1g}")
        above = 1.0 + 0.03 * size[0] / size[1]
        panel.quiverkey(arrows, 0.9, above, key, f"{key:g} px", labelpos="W")
        panel.set_title(name)
    return figure


def draw_corner_coverage(
    views: FloatArray, size: tuple[int, int], name: str, colour: str
) -> Figure:
    """Draw corners over an image, and the number of views with a corner in each part of it."""
    width, height = size
    pixels = views[np.isfinite(views).all(axis=-1)]
    with image_panel(size) as (figure, panel):
        panel.plot(
            *pixels[thinning_slice(len(pixels))].T, ".", ms=3.5, mew=0, alpha=0.6, color=colour,
            rasterized=True,
        )  # fmt: skip
        cells = views_in_cells(views, size)
        wide, high = width / CELLS, height / CELLS
        for row, column in np.ndindex(cells.shape):
            count = int(cells[row, column])
            corner = (column * wide - 0.5, row * high - 0.5)
            panel.add_patch(
                Rectangle(
                    corner, wide, high, fill=False, ec=GREY, lw=0.8, ls=":",
                    hatch=None if count else "///",
                )
            )  # fmt: skip
            panel.text(
                corner[0] + 0.5 * wide, corner[1] + 0.5 * high, f"{count}", ha="center",
                va="center", fontsize=13, fontweight="bold", color=BLACK,
                bbox={"boxstyle": "round,pad=0.2", "fc": "white", "ec": "none", "alpha": 0.8},
            )  # fmt: skip
        panel.set_title(f"{name}, views in each part")
    return figure


def thinning_slice(count: int) -> slice:
    """Thin out dots to at most `_MOST_DOTS`."""
    return slice(None, None, -(-count // _MOST_DOTS) or 1)


@contextmanager
def panels(
    width: float, height: float, rows: int = 1, columns: int = 1, **options: Any
) -> Iterator[tuple[Figure, Any]]:
    """Style a figure with one panel or an array of them, sizes in inches, while it is drawn."""
    with figure_style():
        figure = new_figure(width, height)
        yield figure, figure.subplots(rows, columns, **options)


def draw_matrix(
    panel: Axes, values: FloatArray, texts: NDArray[np.str_], colours: str,
    colour_range: tuple[float, float], fontsize: float, **options: Any,
) -> AxesImage:  # fmt: skip
    """Draw a matrix of numbers as colours with a text in each cell."""
    image = panel.imshow(
        np.ma.masked_invalid(values), cmap=colours, norm=Normalize(*colour_range), **options
    )
    for row, column in np.argwhere(texts != "").tolist():
        panel.text(
            column, row, str(texts[row, column]), ha="center", va="center", fontsize=fontsize,
            color=BLACK,
        )  # fmt: skip
    panel.tick_params(length=0)
    panel.grid(False)
    return image


def residual_limit(kept: FloatArray, medians: float) -> float:
    """End of an axis of residuals: some medians of kept views, unless one of them exceeds it."""
    return max(1.15 * float(kept.max()), medians * float(np.median(kept)))


@contextmanager
def image_panel(size: tuple[int, int]) -> Iterator[tuple[Figure, Axes]]:
    """Style a figure of an image's shape; its axes are the image's frame, v downwards."""
    width, height = size
    beside, above = _MARGINS_IN
    high = (CAMERA_FIGURE_WIDTH - beside) * height / width + above
    with panels(CAMERA_FIGURE_WIDTH, high) as (figure, panel):
        panel.set(
            xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal",
            xlabel="u (px)", ylabel="v (px)",
        )  # fmt: skip
        panel.grid(False)
        panel.spines[:].set_visible(True)
        yield figure, panel


PAGE_WIDTH: Final = 11.2
"""Width of a figure of all cameras or both eyes, inches (chosen)."""
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
_BASELINES: Final = (3.0, 100.0)
"""Nearest and farthest distance of the figure, in baselines (chosen: the range of use)."""
_NEAR_M: Final = 0.2
"""Distance from which on the figure reaches in any case, m (chosen: the range of use)."""
_FAR_M: Final = 5.0
"""Distance up to which the figure reaches in any case, m (chosen: the range of use)."""


def residual_field(calibration: Calibration, camera: int) -> Figure:
    """Draw mean residuals over a camera's image as magnified arrows."""
    size, name = calibration.observations.image_sizes[camera], calibration.camera_names[camera]
    return draw_residual_arrows(*_residuals(calibration, camera), size, name)


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
    with panels(CAMERA_FIGURE_WIDTH, 3.9) as (figure, panel):
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
            ylim=(-limit, limit), title=calibration.camera_names[camera],
        )  # fmt: skip
        legend_below(figure, 2, fontsize=10)
    return figure


def image_coverage(calibration: Calibration, camera: int) -> Figure:
    """Draw the corners used by the calibration over the image, and the views in each part of it."""
    views = calibration.fit.solution.problem.pixels[camera]
    size, name = calibration.observations.image_sizes[camera], calibration.camera_names[camera]
    return draw_corner_coverage(views, size, name, EYE_STYLES[camera]["color"])


def tilt_directions(calibration: Calibration) -> Figure:
    """Plot direction and size of the board's tilts."""
    held = board_tilts(calibration)
    most = max(40.0, *(1.1 * float(each.angle_deg.max()) for each in held))
    with panels(CAMERA_FIGURE_WIDTH, 5.2) as (figure, panel):
        _draw_views(panel, calibration, [each.tilt_deg.T for each in held])
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
    held = board_tilts(calibration)
    with panels(CAMERA_FIGURE_WIDTH, 5.2) as (figure, panel):
        _draw_views(panel, calibration, [(each.distance_m, each.angle_deg) for each in held])
        panel.set(
            xlabel="distance of the board's middle (m)", ylabel="tilt (°)",
            title="tilt and distance of each view's board",
        )  # fmt: skip
        panel.set_ylim(bottom=0.0)
        if len(held) > 1:
            legend_below(figure, 2)
    return figure


def _draw_views(panel: Axes, calibration: Calibration, places: Sequence[Any]) -> None:
    for name, style, (across, up) in zip(
        calibration.camera_names, EYE_STYLES, places, strict=False
    ):
        panel.plot(across, up, label=name, **style, linestyle="none", ms=6, alpha=0.75, mew=0)


def view_residuals(calibration: Calibration) -> Figure:
    """Plot the root mean square of each view's residuals; views left out are hatched."""
    fits = dict(zip(calibration.camera_names, calibration.single_fits, strict=True))
    colours = [EYE_STYLES[camera]["color"] for camera in range(len(fits))]
    if len(fits) > 1:
        fits["both together"] = calibration.fit
        colours.append(GREEN)
    bars = {
        name: np.where(np.isfinite(fit.views.view_chi), fit.views.view_rms_px, 0.0)
        for name, fit in fits.items()
    }
    good = np.concatenate([bars[name][fit.kept_views] for name, fit in fits.items()])
    limit = residual_limit(good, _AXIS_LIMIT_MEDIANS)
    kept = calibration.fit.kept_views
    places, wide = np.arange(len(kept)), 0.8 / len(fits)
    with panels(PAGE_WIDTH, 4.0) as (figure, panel):
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
        labels = [Path(name).stem[-16:] for name in calibration.observations.file_names[0]]
        step = -(-len(kept) // _MOST_NAMED_VIEWS)
        panel.set_xticks(places[::step], labels[::step], rotation=90, fontsize=9)
        panel.tick_params(axis="x", length=0, pad=10)
        if len(fits) > 1:
            handles = [Patch(color=colour) for colour in colours]
            figure.legend(handles, list(fits), loc="outside upper center", ncols=3, fontsize=10)
    return figure


def direction_sigma(calibration: Calibration, camera: int) -> Figure:
    """Draw the standard deviation of directions over a camera's image, and the hull of corners."""
    size = calibration.observations.image_sizes[camera]
    grid = pixel_grid(size, _CONTOUR_GRID_COUNT).transpose(2, 0, 1)
    sigma = direction_sigma_px_at(calibration, camera, _CONTOUR_GRID_COUNT)
    low, high = _LEVELS_PX[0], _LEVELS_PX[-1]
    shown = np.ma.masked_invalid(np.clip(sigma, 1.001 * low, 0.999 * high))
    pixels, _ = _residuals(calibration, camera)
    with image_panel(size) as (figure, panel):
        panel.contourf(*grid, shown, _LEVELS_PX, cmap="Blues", norm=LogNorm(low, 10.0 * high))
        lines = panel.contour(*grid, shown, _LEVELS_PX, colors=BLACK, linewidths=0.8)
        panel.clabel(lines, fmt="%g", fontsize=10)
        panel.set_facecolor("#bbbbbb")
        with suppress(QhullError):  # the pixels are collinear
            pixels = pixels[ConvexHull(pixels).vertices]
            pixels = np.append(pixels, pixels[:1], axis=0)
        panel.plot(*pixels.T, "--", color=ORANGE, lw=2.0)
        panel.set_title(f"{calibration.camera_names[camera]}, sigma of directions (px)")
    return figure


def depths_to_plot_m(calibration: Calibration) -> FloatArray:
    """(n) distances for a figure, m, evenly spaced on a logarithmic scale."""
    baseline = float(np.linalg.norm(calibration.rig.translation))
    near, far = min(_NEAR_M, _BASELINES[0] * baseline), max(_FAR_M, _BASELINES[1] * baseline)
    return np.geomspace(near, far, 80)


def depth_sigma(depth: DepthSigma, in_percent: bool) -> Figure:
    """Plot the standard deviation of depth: from calibration, from one pair's noise, from both."""
    scale = 1e2 / depth.distance_m if in_percent else np.full(len(depth.distance_m), 1e3)
    return draw_by_distance(
        depth.distance_m,
        (
            (scale * depth.calibration_m, "calibration", {"color": BLUE, "linestyle": "-"}),
            (scale * depth.noise_m, "noise of one pair", {"color": ORANGE, "linestyle": "--"}),
            (scale * depth.total_m, "both", {"color": BLACK, "linestyle": ":"}),
        ),
        ("distance (m)", f"sigma of depth ({'%' if in_percent else 'mm'})"),
    )


def draw_by_distance(
    distance_m: FloatArray, lines: Sequence[Line], labels: tuple[str, str],
    *, ticks_m: Sequence[float] = (), columns: int = 3,
) -> Figure:  # fmt: skip
    """Plot lines over the distance, with logarithmic axes; `ticks_m` end at the panel's edges."""
    with panels(CAMERA_FIGURE_WIDTH, 4.4) as (figure, panel):
        for values, label, style in lines:
            panel.loglog(distance_m, values, label=label, **style)
        panel.set(xlabel=labels[0], ylabel=labels[1])
        if len(ticks_m):
            panel.set_xticks(ticks_m, minor=False)
            panel.set_xlim(ticks_m[0], ticks_m[-1])
        else:
            panel.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        panel.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        for axis in (panel.xaxis, panel.yaxis):
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter("")
        legend_below(figure, columns, fontsize=10)
    return figure


def _residuals(calibration: Calibration, camera: int) -> tuple[FloatArray, FloatArray]:
    """(n, 2) measured corners of the kept views, and residuals projected minus measured, px."""
    solution = calibration.fit.solution
    seen = solution.problem.seen[camera]
    return solution.problem.pixels[camera][seen], solution.residuals_px[camera][seen]
