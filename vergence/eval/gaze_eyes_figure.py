"""Images of a gaze's eyes, with the target's path, both magnified alike."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from vergence.eval.gaze import GazeResult
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.reporting.style import Labels, as_float_pair

EYE_COLOURS: Final = ("#1f6fb4", "#d1571b")
GREEN: Final = "#14803c"
"""Colour of what is measured."""
Place = tuple[float, float, float, float]
"""Left, bottom, width and height of a panel, inches."""
_LABEL_LEFT, _LABEL_BELOW = 0.56, 0.3  # inches (chosen)
_MOST_INTERVALS: Final = 6
"""Largest number of intervals between an axis' ticks (chosen: drawing ticks takes long)."""
_MOST_MAGNIFIED_FRACTION: Final = 0.12
"""Largest half width of the magnified part, as a fraction of the image's width; wider parts are not
magnified (chosen: detail against clutter)."""
_MAGNIFIED_SIDE: Final = 1.9
"""Side of a magnified part, inches (chosen: room for its labels)."""


def add_panel(figure: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
    """Axes at a place in inches; no layout is computed, which would take longer than drawing."""
    size = figure.get_size_inches()
    axes = figure.add_axes((left / size[0], bottom / size[1], width / size[0], height / size[1]))
    axes.locator_params(nbins=_MOST_INTERVALS)
    axes.xaxis.set_label_coords(0.5, -_LABEL_BELOW / height)
    axes.yaxis.set_label_coords(-_LABEL_LEFT / width, 0.5)
    return axes


def columns_of(result: GazeResult, what: str, eye: int) -> FloatArray:
    """(n, 2) two columns of an eye in a trajectory, by their first word, such as pixel."""
    name = EYE_NAMES[eye]
    return np.stack([result.trajectory[f"{what}_{name}_{axis}_px"] for axis in "uv"], axis=1)


def draw_eyes(figure: Figure, result: GazeResult, places: Sequence[Place]) -> None:
    """Draw both eyes' images, magnified alike if their marks take up a small part of them.

    Args:
        figure: the figure.
        result: the gaze.
        places: the room for each image.
    """
    paths = [
        columns_of(result, "true_pixel" if result.has_truth else "pixel", eye) for eye in range(2)
    ]
    paths = [path[np.isfinite(path).all(axis=1)] for path in paths]
    marks = [
        np.vstack([path, centre])
        for path, centre in zip(paths, result.head.cameras.principal, strict=True)
    ]
    middles = [0.5 * (points.min(axis=0) + points.max(axis=0)) for points in marks]
    half = 60.0 + max(np.abs(p - m).max() for p, m in zip(marks, middles, strict=True))
    sizes = np.array(result.head.cameras.size, np.float64)
    corner = None
    if half < _MOST_MAGNIFIED_FRACTION * sizes[:, 0].min():
        corner = _free_corner([m / size for m, size in zip(middles, sizes, strict=True)])
    for eye, path in enumerate(paths):
        left, bottom, width, height = places[eye]
        scale = min((width, height) / sizes[eye])  # inches per px
        used = scale * sizes[eye]
        place = (left + 0.5 * (width - used[0]), bottom + 0.5 * (height - used[1]), *used)
        axes = add_panel(figure, *place)
        axes.set(
            xlim=(-0.5, sizes[eye, 0] - 0.5), ylim=(sizes[eye, 1] - 0.5, -0.5),
            xlabel="u (px)", ylabel="v (px)",
            title=f"{EYE_NAMES[eye]} eye, {_what_is_shown(result)}",
        )  # fmt: skip
        axes.spines[:].set_visible(result.images is None)
        _draw_marks(axes, result, eye, path)
        named = axes
        if corner is not None:
            side = min(_MAGNIFIED_SIDE, height) * np.array([1.0 / used[0], 1.0 / used[1]])
            low = 0.01 + np.array(corner) * (0.98 - side)
            named = axes.inset_axes((*low, *side))
            (u, v) = middles[eye]
            named.set(xlim=(u - half, u + half), ylim=(v + half, v - half))
            named.xaxis.set_visible(False)
            named.yaxis.set_visible(False)
            named.spines[:].set(visible=True, color=EYE_COLOURS[eye], linewidth=1.5)
            _draw_marks(named, result, eye, path)
            axes.indicate_inset_zoom(named, edgecolor=EYE_COLOURS[eye], alpha=1.0)
        _name_marks(named, result, eye, path)


def _free_corner(middles: list[FloatArray]) -> tuple[int, int]:
    """Corner (right, top) that is farthest from both eyes' marks, fractions of the image."""

    def distance(corner: tuple[int, int]) -> float:
        far = np.array([corner[0], 1 - corner[1]], np.float64)
        return round(min(float(np.linalg.norm(far - middle)) for middle in middles), 1)

    return max(((1, 1), (0, 1), (1, 0), (0, 0)), key=distance)


def _draw_marks(axes: Axes, result: GazeResult, eye: int, path: FloatArray) -> None:
    """Draw an eye's image with the path on it, without changing the limits."""
    limits = axes.axis()
    width, height = result.head.cameras.size[eye]
    if result.images is not None:
        axes.imshow(
            result.images.of(eye), cmap="gray", vmin=0, vmax=255, aspect="auto",
            interpolation_stage="data",  # greys are linear in the data: the same
            extent=(-0.5, width - 0.5, height - 0.5, -0.5),
        )  # fmt: skip
    halo = [withStroke(linewidth=4.0, foreground="white")]
    axes.plot(*path.T, color=EYE_COLOURS[eye], lw=2.0, path_effects=halo)
    axes.plot(*path[:1].T, "o", color=EYE_COLOURS[eye], ms=8, mfc="white", mew=2)
    axes.plot(
        *result.head.cameras.principal[eye], "+", color="black", ms=24, mew=1.4, zorder=5,
        path_effects=[withStroke(linewidth=2.6, foreground="white")],
    )  # fmt: skip
    axes.plot(*_last_detection(result, eye).T, "x", color=GREEN, ms=10, mew=2.4, zorder=6)
    axes.axis(limits)


def _last_detection(result: GazeResult, eye: int) -> FloatArray:
    """(1, 2) the last pixels detected by an eye, or (0, 2) if there are none."""
    seen = columns_of(result, "pixel", eye)
    return seen[np.isfinite(seen).all(axis=1)][-1:]


def _name_marks(axes: Axes, result: GazeResult, eye: int, path: FloatArray) -> None:
    """Name the marks of an eye next to them, apart from each other."""
    labels = Labels(axes)
    for start, end in pairwise(path[:: max(1, len(path) // 20)]):
        labels.avoid_line(start, end)
    centre = result.head.cameras.principal[eye]
    away = path[0] - centre if len(path) else np.array([0.0, -1.0])
    names = [(centre, "principal point", "black", (-away[0], 1.0))]
    names += [
        (point, "last detection", GREEN, (away[0], 1.0)) for point in _last_detection(result, eye)
    ]
    followed = "target's path,\nfrom time zero" if result.has_truth else "detections' path"
    names += [(point, followed, EYE_COLOURS[eye], as_float_pair(away)) for point in path[:1]]
    for point, *_ in names:
        labels.avoid(point, 9.0)
    white = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5}
    for point, text, colour, direction in reversed(names):
        labels.add(point, text, colour, direction, fontsize=10, bbox=white)
    labels.place()


def _what_is_shown(result: GazeResult) -> str:
    if result.images is None:
        return "detections (no images)"
    return "drawn for the last posture (no camera)" if result.images.drawn else "last image"
