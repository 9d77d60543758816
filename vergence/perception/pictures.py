"""Pictures of photographs with their detections, and of located targets in space."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from numpy.typing import NDArray

from vergence.files import atomic_file
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.perception.finding import Photograph, tag_number
from vergence.perception.locate import MM, LocatedTarget, LocateResult
from vergence.perception.photographs import join_first_names
from vergence.reporting.style import (
    BLUE,
    GREY,
    ORANGE,
    as_float_pair,
    figure_style,
    legend_below,
    new_figure,
)
from vergence.vision import BoardDetection
from vergence.vision.pose import Pose
from vergence.vision.targets import AprilTag, PlanarTarget

COLOURS: Final = ("#00a2ff", "#ff7a00", "#00c060", "#d84bff", "#e8c000", "#ff4060")
"""Colours of targets, assigned in order; they stand out from grey images."""
_TITLE_PT: Final = 10.0
"""Font size of a panel's title, pt (chosen: legibility)."""
_LETTER_WIDTH: Final = 0.62
"""Estimated width of a letter as a fraction of the font size, slightly above the mean of file names
(chosen)."""
_NUMBER_PT: Final = (3.5, 12.0)
"""Least and largest font size of a tag's number, pt (chosen: legibility)."""


_AXIS_COLOURS: Final = ("#ff2020", "#20c020", "#2060ff")
"""Colours of a target's axes x, y and z, as OpenCV draws them."""
_MOST_DRAWN_AXES: Final = 12
"""Most targets whose axes are drawn in space (chosen: more tangle)."""
_AXIS_LENGTHS: Final = (0.65, 0.3)
"""Length of the axes of a tag and of a board as a fraction of its extent (chosen: a tag's end in
its white margin, beside its number; a board's begin at a corner)."""


def axes_in_space(target: PlanarTarget, pose: Pose) -> FloatArray:
    """(4, 3) origin of T and the ends of its axes in the frame of its pose, metres."""
    share = _AXIS_LENGTHS[tag_number(target) is None]
    length = share * pose.size_ratio * float(np.ptp(target.corners_m, axis=0).max())
    ends = length * np.concatenate([np.zeros((1, 3)), np.eye(3)])
    return np.asarray(ends @ pose.matrix[:3, :3].T + pose.matrix[:3, 3])


def _draw_axes(panel: Axes, points: FloatArray, width_pt: float) -> None:
    """Draw axes, (4, 2) origin and ends, x red, y green, z blue."""
    for axis, end, colour in zip("xyz", points[1:], _AXIS_COLOURS, strict=True):
        line = np.stack([points[0], end]).T
        panel.plot(
            *line, lw=width_pt, color=colour, solid_capstyle="round", label=f"{axis} of target"
        )


TargetColours = Mapping[str, str]


def _new_colours() -> TargetColours:
    """Colours by the name of a target, the next one for each name asked for first."""
    return defaultdict(cycle(COLOURS).__next__)


def target_outline(target: PlanarTarget, corners: FloatArray) -> FloatArray:
    """(m, k) closed line of the outermost of a target's (n, k) corners, without missing ones."""
    x, y = target.corners_m.T
    close = 1e-6 * np.ptp(target.corners_m)
    sides = (
        (y < y.min() + close, x),
        (x > x.max() - close, y),
        (y > y.max() - close, -x),
        (x < x.min() + close, -y),
    )
    around = [np.flatnonzero(side)[np.argsort(along[side])] for side, along in sides]
    order = np.concatenate(around)
    line = corners[order[np.isfinite(corners[order]).all(axis=-1)]]
    return np.concatenate([line, line[:1]])


def draw_detections(
    panel: Axes,
    image: NDArray[np.uint8],
    found: Sequence[BoardDetection],
    colours: TargetColours,
    axes_px: Mapping[str, FloatArray],
) -> None:
    """Draw an image with its targets: corners, outline, upper left corner, and numbers of tags.

    The axes of some are drawn too, (4, 2) pixels of their origin and ends by the target's name.
    """
    height, width = image.shape
    pt_per_px = 72.0 / panel.figure.dpi * panel.bbox.width / width
    panel.imshow(image, cmap="gray", vmin=0, vmax=255, interpolation="antialiased")
    for detection in found:
        target, corners = detection.target, detection.corners_px
        style: dict[str, Any] = {"color": colours[str(target)]}
        outline = target_outline(target, corners)
        # marks of a small target are small, so that they lie on no other
        across_pt = pt_per_px * float(np.ptp(outline, axis=0).min())
        fine = min(across_pt / 40.0, 1.0)
        panel.plot(*outline.T, lw=max(1.4 * fine, 0.7), **style)
        if len(corners) > 4:
            panel.plot(*corners.T, "+", ms=5, mew=1.0, **style)
        first = np.nanargmin(corners.sum(axis=1) * 0.0 + target.corners_m.sum(axis=1))
        panel.plot(
            *corners[first], "s", ms=max(7.0 * fine, 2.0), mfc="none", mew=1.8 * fine, **style
        )
        if str(target) in axes_px:
            _draw_axes(panel, axes_px[str(target)], max(2.2 * fine, 0.8))
        if isinstance(target, AprilTag):
            number = str(target.id)
            size_pt = float(np.clip(across_pt / (_LETTER_WIDTH * len(number) + 0.3), *_NUMBER_PT))
            edge = patheffects.withStroke(linewidth=0.25 * size_pt, foreground="black", alpha=0.75)
            panel.text(
                *as_float_pair(detection.point_px), number, ha="center", va="center",
                fontsize=size_pt, fontweight="bold", path_effects=[edge], **style,
            )  # fmt: skip
    panel.grid(False)
    panel.set(
        xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal", xticks=[], yticks=[]
    )
    panel.spines[:].set_visible(False)


def shorten_to_width(text: str, width_in: float, size_pt: float) -> str:
    """Cut the middle out of a text that is wider than a width in inches, at a font size in pt."""
    most = max(int(width_in * 72.0 / (_LETTER_WIDTH * size_pt)), 8)
    if len(text) <= most:
        return text
    return f"{text[: most // 2 - 1]} … {text[-(most - most // 2 - 2) :]}"


def _title(name: str, found: Sequence[BoardDetection], width_in: float) -> str:
    """An image's name, its boards and number of tags, on two lines if too wide for one."""
    said = [str(one.target) for one in found if tag_number(one.target) is None]
    tags = len(found) - len(said)
    if tags:
        said.append(f"{tags} {'tag' if tags == 1 else 'tags'}")
    what = ", ".join(said) or "nothing found"
    line = f"{name}: {what}"
    if shorten_to_width(line, width_in, _TITLE_PT) == line:
        return line
    return "\n".join(shorten_to_width(part, width_in, _TITLE_PT) for part in (name, what))


def draw_photographs(photographs: Sequence[Photograph], path: Path) -> None:
    """Draw photographs next to each other into a PNG file, replaced if it exists."""
    _save(compose_detections(photographs), path)


def draw_located(result: LocateResult, path: Path) -> None:
    """Draw located targets into a PNG file, replaced if it exists."""
    _save(compose_located(result), path)


def _save(figure: Figure, path: Path) -> None:
    with figure_style(), atomic_file(path) as partial:
        figure.savefig(partial, format="png", dpi=110, metadata={"Software": None})


def compose_detections(photographs: Sequence[Photograph]) -> Figure:
    """Compose the figure of `draw_photographs`."""
    columns = 1 if len(photographs) == 1 else 2 if len(photographs) <= 4 else 3
    across = {1: 9.0, 2: 6.2, 3: 4.6}[columns]
    tall = [image.shape[0] / image.shape[1] for _, image, _ in photographs]
    heights = [
        across * max(tall[start : start + columns]) + 0.5
        for start in range(0, len(photographs), columns)
    ]
    colours = _new_colours()
    with figure_style():
        figure = new_figure(across * columns, sum(heights))
        grid = figure.add_gridspec(len(heights), columns, height_ratios=heights)
        for place, (name, image, found) in enumerate(photographs):
            panel = figure.add_subplot(grid[divmod(place, columns)])
            axes_px = {
                str(one.target): one.camera.project(axes_in_space(one.target, pose))
                for one in found
                if one.camera is not None and (pose := one.pose) is not None
            }
            draw_detections(panel, image, found, colours, axes_px)
            panel.set_title(_title(name.name, found, across), fontsize=_TITLE_PT)
    return figure


_VIEWS: Final = (
    ("from above", 0, 2, "x (mm), right", "z (mm), forward"),
    ("from the right", 2, 1, "z (mm), forward", "y (mm), down"),
)
"""Title, axes of N across and up the page, and their labels; y points down the page."""
_EYE_COLOURS: Final = (BLUE, ORANGE)
_LEAST_SEMI_AXIS_PT: Final = 2.0
"""Least semi-axis at which an ellipse is visible around its point, pt (chosen)."""
_ELLIPSE_SIGMAS: Final = (1, 3, 10, 30)
"""Scales of the ellipses, in standard deviations; the first visible one is used (chosen)."""
_FIGURE_WIDTH_IN: Final = 12.5
"""Width of the figure, inches (chosen: legibility)."""
_VIEWS_HEIGHT_IN: Final = 5.4
"""Height of the views of space, inches (chosen: legibility)."""
# Font sizes, pt (chosen: legibility).
_HEADING_PT: Final = 13.0
_PANEL_TITLE_PT: Final = 12.0

_MOST_DRAWN_PAIRS: Final = 5
"""Most image pairs whose points are all drawn; of more, only the points of the pair shown above are
drawn (chosen: legibility)."""
_FAR_DISTANCE_RATIO: Final = 5.0
"""Ratio to the usual distance of targets beyond which a point is left out of the views, where it
would shrink all others to a dot (chosen)."""


def compose_located(result: LocateResult) -> Figure:
    """Compose the figure: the images of both eyes, and the targets in space."""
    shown, colours = result.shown, _new_colours()
    pair = shown[0].path.name
    posed = [(one, one.pose) for one in result.located if one.pair == pair and one.pose is not None]
    tall = max(each.image.shape[0] / each.image.shape[1] for each in shown)
    top = 0.5 * _FIGURE_WIDTH_IN * tall + 0.4
    with figure_style():
        seen = [one for one in result.located if one.valid.any()]
        # without a valid point, the views of space would be empty
        heights = (top, _VIEWS_HEIGHT_IN) if seen else (top,)
        figure = new_figure(_FIGURE_WIDTH_IN, sum(heights))
        grid = figure.add_gridspec(len(heights), 2, height_ratios=heights)
        for eye, name in enumerate(EYE_NAMES):
            panel = figure.add_subplot(grid[0, eye])
            axes_px = {
                str(one.target): result.head.project(
                    result.angles[pair], axes_in_space(one.target, pose)
                )[:, eye]
                for one, pose in posed
            }
            draw_detections(panel, shown[eye].image, shown[eye].detections, colours, axes_px)
            nothing = "" if shown[eye].detections else ", nothing found"
            title = shorten_to_width(
                f"{name}: {shown[eye].path.name}", 0.35 * _FIGURE_WIDTH_IN, _PANEL_TITLE_PT
            )
            panel.set_title(f"{title}{nothing}", color=_EYE_COLOURS[eye], fontsize=_PANEL_TITLE_PT)
        if seen:
            panels = [figure.add_subplot(grid[1, column]) for column in range(len(_VIEWS))]
            _draw_space(figure, panels, result, seen, colours)
        heading = shorten_to_width(_heading(result, seen), 0.95 * _FIGURE_WIDTH_IN, _HEADING_PT)
        figure.suptitle(heading, fontsize=_HEADING_PT)
    return figure


_Drawn = Sequence[tuple[LocatedTarget, NDArray[np.bool_]]]
"""Targets with an (n,) mask of their corners that the views of space show."""


def _draw_space(
    figure: Figure,
    panels: Sequence[Axes],
    result: LocateResult,
    seen: Sequence[LocatedTarget],
    colours: TargetColours,
) -> None:
    """Draw both views of space, with the number of points outside them."""
    eyes = np.concatenate(
        [MM * result.head.camera_poses(q)[:, :3, 3] for q in result.angles.values()]
    )
    away = [np.linalg.norm(one.fix.point, axis=-1) for one in seen]
    usual = np.median([np.median(d[one.valid]) for d, one in zip(away, seen, strict=True)])
    most = _FAR_DISTANCE_RATIO * usual
    near = [(one, one.valid & (d <= most)) for d, one in zip(away, seen, strict=True)]
    outside = int(sum(one.valid.sum() - drawn.sum() for one, drawn in near))
    shown = result.shown[0].path.name
    for panel, (title, across, up, xlabel, ylabel) in zip(panels, _VIEWS, strict=True):
        _draw_view(panel, near, eyes, [across, up], colours, shown)
        panel.set(xlabel=xlabel, ylabel=ylabel, title=title)
    legend_below(figure, 5)
    figure.draw_without_rendering()  # ellipses are scaled to the panels' final size
    _draw_sigma(panels, near, colours)
    if outside:
        points = "point lies" if outside == 1 else "points lie"
        farther = f"{outside} {points} farther away, outside"
        panels[0].set_title(f"{panels[0].get_title()}\n{farther}", fontsize=_PANEL_TITLE_PT)


def _heading(result: LocateResult, seen: Sequence[LocatedTarget]) -> str:
    count = len({one.pair for one in seen})
    what = join_first_names(dict.fromkeys(str(one.target) for one in seen), 3)
    if not seen:
        why = "the lines of sight do not cross" if result.located else "no target in both images"
        return f"head {result.head.name}: {why}, nothing located"
    pairs = f"{count} of {len(result.angles)} pairs" if len(result.angles) > 1 else seen[0].pair
    return f"head {result.head.name}: {what}, {pairs}"


def _draw_view(
    panel: Axes,
    near: _Drawn,
    eyes: FloatArray,
    axes: list[int],
    colours: TargetColours,
    shown: str,
) -> None:
    for eye, name in enumerate(EYE_NAMES):
        panel.plot(
            *eyes[eye::2][:, axes].T, "s", color=_EYE_COLOURS[eye], ms=8, label=f"{name} eye"
        )
    pairs = {one.pair for one, _ in near}
    many, crowded = len(pairs) > 1, len(pairs) > _MOST_DRAWN_PAIRS
    for one, drawn in near:
        points, colour = MM * one.fix.point[:, axes], colours[str(one.target)]
        points = np.where(drawn[:, None], points, np.nan)
        line = target_outline(one.target, points)
        behind = crowded and one.pair != shown
        panel.plot(*line.T, lw=0.8 if behind else 1.2, alpha=0.4 if behind else 1.0, color=colour)
        if not behind:
            panel.plot(*points.T, ".", ms=2.5 if many else 4.0, color=colour)
            if one.pose is not None and drawn.any() and len(near) <= _MOST_DRAWN_AXES:
                ends = MM * axes_in_space(one.target, one.pose)[:, axes]
                _draw_axes(panel, ends, 0.8 if many or len(near) > 5 else 1.4)
        if not many and (drawn == one.valid).all():
            for place in eyes[:2][:, axes]:
                sight = np.stack([place, MM * one.centre.point[axes]])
                panel.plot(*sight.T, ":", color=GREY, lw=1.0 if len(near) <= 5 else 0.4)
    panel.set_aspect("equal", adjustable="datalim")
    if axes[1] == 1:
        panel.invert_yaxis()
    panel.margins(0.08)


def _draw_sigma(panels: Sequence[Axes], near: _Drawn, colours: TargetColours) -> None:
    """Draw covariance ellipses at outermost corners, at the first scale that makes them visible."""
    chosen = [
        (MM * one.fix.point[corner], MM**2 * one.fix.covariance[corner], one)
        for one, drawn in near
        for corner in _outermost(one, drawn)
    ]
    if not chosen:
        return
    largest = np.median([np.sqrt(np.linalg.eigvalsh(c)[-1]) for _, c, _ in chosen])
    ends = panels[0].transData.transform([(0.0, 0.0), (largest, 0.0)])
    size_pt = (ends[1, 0] - ends[0, 0]) * 72.0 / panels[0].figure.dpi
    scale = next((s for s in _ELLIPSE_SIGMAS if s * size_pt >= _LEAST_SEMI_AXIS_PT), None)
    if scale is None:
        return
    for panel, (_, *axes, _, _) in zip(panels, _VIEWS, strict=True):
        for point, covariance, one in chosen:
            values, vectors = np.linalg.eigh(covariance[np.ix_(axes, axes)])
            panel.add_patch(
                Ellipse(
                    as_float_pair(point[axes]),
                    *(2.0 * scale * np.sqrt(np.maximum(values, 0.0))),
                    angle=np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])),
                    fill=False,
                    edgecolor=colours[str(one.target)],
                    lw=0.8,
                    alpha=0.8,
                )
            )
        panel.set_title(f"{panel.get_title()}; ellipses: {scale} sigma")


def _outermost(one: LocatedTarget, drawn: NDArray[np.bool_]) -> list[int]:
    """Indices of the drawn corners that are farthest out along the diagonals of the board."""
    valid = np.flatnonzero(drawn)
    if not len(valid):
        return []
    x, y = one.target.corners_m[valid].T
    return list(dict.fromkeys(int(valid[d.argmin()]) for d in (x + y, y - x, -x - y, x - y)))
