"""Common style of figures, readable in greyscale, on phones and on paper; names in figures."""

import io
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, Final

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Annotation
from matplotlib.transforms import ScaledTranslation
from numpy.typing import NDArray

from vergence.models.parts import FloatArray

BLUE: Final = "#1f6fb4"
ORANGE: Final = "#d1571b"
GREEN: Final = "#14803c"
PURPLE: Final = "#7a4fa3"
BLACK: Final = "#222222"
GREY: Final = "#777777"

METHOD_STYLE: Final[dict[str, dict[str, Any]]] = {
    "gaze": {"color": BLUE, "marker": "o", "linestyle": "-", "label": "gaze"},
    "itpc": {"color": ORANGE, "marker": "s", "linestyle": "--", "label": "ITPC"},
}
"""Line styles of the two methods, with different markers and dashes as well as colours."""
ARTICLE_STYLE: Final[dict[str, Any]] = {"color": BLACK, "linestyle": ":", "linewidth": 1.3}
"""Line style of the article's values."""
ARTICLE_BAND: Final[dict[str, Any]] = {"color": GREY, "alpha": 0.18, "linewidth": 0.0}
"""Style of a range of the article's values."""

_AXIS_LABEL_IN: Final = 0.45
"""Height of a horizontal axis with its numbers and label, inches (measured on the font's size)."""
_RC: Final[Any] = {
    "font.size": 11,
    "axes.titlesize": 12,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "lines.linewidth": 1.8,
    "lines.markersize": 5,
    "svg.hashsalt": "vergence",
    "svg.fonttype": "none",
    "figure.dpi": 110,
}


def new_figure(width: float = 9.0, height: float = 4.2) -> Figure:
    """Make an empty figure, with sizes in inches; draw it inside `figure_style`."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def log_axis(panel: Axes, which: str = "y") -> None:
    """Make an axis, x or y, logarithmic with plain numbers; more of them over few decades."""
    panel.set(**{f"{which}scale": "log"})
    axis = panel.xaxis if which == "x" else panel.yaxis

    def minor(value: float, _: object) -> str:
        decades = abs(np.subtract(*np.log10(axis.get_view_interval())))
        marked = () if decades > 2.2 else (2, 5) if decades > 1.1 else (2, 3, 5, 7)
        digit = round(value / 10.0 ** np.floor(np.log10(value) + 1e-9))
        return f"{value:g}" if digit in marked else ""

    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(minor)


def legend_below(of: Figure | Axes, columns: int, **options: Any) -> None:
    """Add a legend below a panel, or one below a figure for all its panels, each label once."""
    place: dict[str, Any] = {"loc": "outside lower center"}
    if isinstance(of, Axes):
        shift = ScaledTranslation(0.0, -_AXIS_LABEL_IN, of.figure.dpi_scale_trans)
        place = {"loc": "upper center", "bbox_to_anchor": (0.5, 0.0),
                 "bbox_transform": of.transAxes + shift}  # fmt: skip
    handles: dict[str, Any] = {}
    for panel in [of] if isinstance(of, Axes) else of.axes:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    of.legend(handles.values(), handles.keys(), ncols=columns, **{**place, **options})


def figure_style() -> AbstractContextManager[None]:
    """Context for drawing and saving figures in this style."""
    return matplotlib.rc_context(_RC)


def save_figure(figure: Figure, stem: Path) -> None:
    """Write a figure as `stem`.svg and `stem`.png; equal figures give equal bytes."""
    with figure_style():
        figure.draw_without_rendering()  # panels with equal axes fit only after a second layout
        figure.savefig(stem.with_suffix(".svg"), metadata={"Date": None})
        figure.savefig(stem.with_suffix(".png"), dpi=110, metadata={"Software": None})


def svg_text(figure: Figure) -> str:
    """Render a figure as the text of an SVG file."""
    text = io.StringIO()
    with figure_style():
        figure.savefig(text, format="svg", metadata={"Date": None})
    return text.getvalue()


_CANDIDATE_DISTANCES_PT: Final = (3.0, 8.0, 14.0, 22.0, 32.0, 44.0, 58.0, 74.0, 92.0)
"""Candidate distances between a point and the box of its text, pt (chosen)."""
_CANDIDATE_TURNS_RAD: Final = np.array(
    [0.0, *(s * a for a in np.arange(1, 9) * np.pi / 8 for s in (1, -1))]
)
"""Candidate directions of a text relative to the requested one, radians, nearest first."""
_LEADER_LINE_DISTANCE_PT: Final = 20.0
"""Distance between a text and its point beyond which a line joins them, pt (chosen)."""
_TEXT_MARGIN_PT: Final = 2.5
"""Free margin around a text, pt (chosen)."""


def as_float_pair(point: FloatArray) -> tuple[float, float]:
    """Convert a point (2,) to two floats, the type that matplotlib's signatures state."""
    return float(point[0]), float(point[1])


class Labels:
    """Texts of a panel, which are placed next to their points without overlaps."""

    def __init__(self, panel: Axes) -> None:
        self._panel = panel
        self._texts: list[tuple[FloatArray, Annotation, FloatArray]] = []
        self._points: list[tuple[FloatArray, float]] = []
        self._lines: list[FloatArray] = []

    def add(
        self, point: FloatArray, text: str, colour: str, direction: Iterable[float], **style: Any
    ) -> None:
        """Add a text, preferably in the direction `direction` (across, up) from its point."""
        annotation = self._panel.annotate(
            text, as_float_pair(point), (0, 0), textcoords="offset points", color=colour,
            ha="center", va="center", zorder=8, **{"fontsize": 11, **style},
        )  # fmt: skip
        annotation.set_in_layout(False)  # its position is known only after the panel's layout
        self._texts.append((np.array(point), annotation, np.array(tuple(direction), np.float64)))

    def avoid(self, point: FloatArray, radius: float = 4.0) -> None:
        """Keep texts away from a point, by a radius in pt."""
        self._points.append((np.array(point), radius))

    def avoid_line(self, start: FloatArray, end: FloatArray) -> None:
        """Keep texts away from a line."""
        self._lines.append(np.array([start, end]))

    def place(self) -> None:
        """Place all texts; call it after the layout of the figure."""
        to_points = 72.0 / self._panel.figure.dpi
        transform = self._panel.transData
        corners = to_points * np.array(self._panel.bbox.get_points())
        taken = [(to_points * transform.transform(p), np.full(2, r)) for p, r in self._points]
        for line in self._lines:
            ends = to_points * transform.transform(line)
            count = min(int(np.linalg.norm(ends[1] - ends[0]) / 4.0) + 2, 400)
            shares = np.linspace(0.0, 1.0, count)
            taken += [(ends[0] + t * (ends[1] - ends[0]), np.ones(2)) for t in shares]
        for point, annotation, direction in self._texts:
            anchor = to_points * transform.transform(point)
            box = annotation.get_window_extent()
            half = 0.5 * to_points * np.array([box.width, box.height]) + _TEXT_MARGIN_PT
            wanted = transform.transform(point + 1e-3 * direction) - transform.transform(point)
            angle = float(np.arctan2(wanted[1], wanted[0]))
            offset = _free_offset(anchor, half, angle, taken, corners)
            taken.append((anchor + offset, half))
            annotation.set_position(as_float_pair(offset))
            if np.linalg.norm(np.maximum(np.abs(offset) - half, 0.0)) > _LEADER_LINE_DISTANCE_PT:
                self._panel.annotate(
                    "", as_float_pair(point), as_float_pair(offset), textcoords="offset points",
                    arrowprops={"arrowstyle": "-", "color": annotation.get_color(), "lw": 0.6,
                                "shrinkA": 8.0, "shrinkB": 2.0},
                )  # fmt: skip


def _free_offset(
    anchor: FloatArray,
    half: FloatArray,
    angle: float,
    taken: Sequence[tuple[FloatArray, FloatArray]],
    corners: FloatArray,
) -> FloatArray:
    """Offset of a text's box from its point, pt: the first candidate without an overlap.

    The box has to lie within the panel. Candidates at nearer distances come first, and at each
    distance directions closer to the wanted one. If all overlap, the one with the least overlap is
    taken.
    """
    towards = np.column_stack(
        [np.cos(angle + _CANDIDATE_TURNS_RAD), np.sin(angle + _CANDIDATE_TURNS_RAD)]
    )
    places = []
    for distance in _CANDIDATE_DISTANCES_PT:
        # the box's edge, not its centre, is at this distance from the point
        edge = np.min(half / np.maximum(np.abs(towards), 1e-9), axis=1)
        places.append(towards * (edge + distance)[:, None])
    offsets = np.concatenate(places)
    centres = anchor + offsets
    outside = np.maximum(corners[0] - (centres - half), (centres + half) - corners[1])
    cost = 1e3 * np.maximum(outside, 0.0).sum(axis=1)
    if taken:
        at = np.array([place for place, _ in taken])
        size = np.array([other for _, other in taken])
        covered = half + size - np.abs(centres[:, None] - at)
        cost += np.prod(np.maximum(covered, 0.0), axis=2).sum(axis=1)
    return np.asarray(offsets[int(np.argmin(cost))], np.float64)


_SAMPLE_PT: Final = 3.0
"""Distance between the points that stand for a line, pt (chosen: less than a text's height)."""
_ANCHOR_STEP: Final = 3
"""Points of a line from one candidate anchor to the next (chosen: speed)."""
_DIRECTIONS: Final = np.array([(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)])
"""Candidate directions of a name from its line: right, left, above, below (chosen)."""
_DISTANCES_PT: Final = np.array([4.0, 8.0, 12.0, 18.0, 28.0, 44.0, 64.0, 90.0])
"""Candidate distances between a line and its name, pt (chosen)."""
_LEADER_PT: Final = 8.0
"""Distance from a line, or its marker, beyond which a leader joins a name to it, pt (chosen)."""
_CROSSED_PT: Final = 15.0
"""Distance that is as bad as another line across the leader, pt (chosen)."""
_CONFUSED_PT: Final = 30.0
"""Distance that is as bad as another line where the leader begins, pt (chosen)."""
_NEAR_PT: Final = 4.0
"""Distance at which another line is at the anchor, or is crossed by a leader, pt (chosen)."""
_MOST_PT: Final = 160.0
"""Cost of a place, pt, above which a name is not legible as the line's (chosen)."""
_MARGIN_PT: Final = 1.0
"""Free margin around a name, pt (chosen)."""


def label_lines(*panels: Axes, **style: Any) -> bool:
    """Write the label of each line next to it, in the panel with the most room.

    Returns:
        False, with the panels as they were, if none has a legible place for each label.
    """
    found = [_Names(panel, style) for panel in panels]
    best = min(found, key=lambda names: names.worst)
    for names in found:
        if names is not best or best.worst > _MOST_PT:
            names.remove()
    return best.worst <= _MOST_PT


class _Names:
    """The names of a panel's lines, written next to them as far as there is room."""

    worst: float
    """Cost of the worst place, pt; infinite if a name has none."""

    def __init__(self, panel: Axes, style: dict[str, Any]) -> None:
        lines = [line for line in panel.get_lines() if not str(line.get_label()).startswith("_")]
        scale = 72.0 / panel.figure.dpi
        origin, end = scale * np.array(panel.bbox.get_points())
        paths = [_points(line, scale) - origin for line in lines]
        paths = [path[((path >= 0.0) & (path <= end - origin)).all(axis=1)] for path in paths]
        maps = [_map(path, end - origin) for path in paths]
        extents = [text.get_window_extent().get_points() for text in panel.texts]
        boxes = [scale * np.array(extent) - origin for extent in extents]
        marks = [box - origin for line in panel.get_lines() for box in _marks(line, scale)]
        self._texts = [_annotate(panel, line, style) for line in lines]
        sizes = [text.get_window_extent().size for text in self._texts]
        halves = [0.5 * scale * np.array(size) for size in sizes]

        def best(number: int) -> tuple[float, FloatArray, FloatArray]:
            ordered = [maps[number], *maps[:number], *maps[number + 1 :]]
            return _best_place(paths[number], halves[number], ordered, boxes, marks)

        self.worst = 0.0
        # the hardest first
        for number in sorted(range(len(lines)), key=lambda number: -best(number)[0]):
            cost, anchor, centre = best(number)
            self.worst = max(self.worst, cost)
            if self.worst > _MOST_PT:
                return
            text, half = self._texts[number], halves[number]
            edge = np.clip(anchor, centre - half, centre + half)
            boxes += [np.array([centre - half, centre + half]), np.sort([anchor, edge], axis=0)]
            text.set_position(as_float_pair(centre))
            text.xy = as_float_pair(anchor)
            marker = np.ptp(_marks(lines[number], scale)[:1], axis=1).max(initial=0.0)
            near = np.linalg.norm(edge - anchor) <= _LEADER_PT + 0.5 * marker
            if near and text.arrow_patch:
                text.arrow_patch.set_visible(False)

    def remove(self) -> None:
        """Take the names away again."""
        for text in self._texts:
            text.remove()


def _annotate(panel: Axes, line: Line2D, style: dict[str, Any]) -> Annotation:
    """Text with a line's label and a leader, at no place yet."""
    text = panel.annotate(
        str(line.get_label()), (0, 0), (0, 0), xycoords="axes points", zorder=8,
        textcoords="axes points", ha="center", va="center", color=line.get_color(),
        arrowprops={"arrowstyle": "-", "color": line.get_color(), "lw": 0.8, "shrinkA": 0.0,
                    "shrinkB": 0.0}, **style,
    )  # fmt: skip
    text.set_in_layout(False)
    return text


def _points(line: Line2D, scale: float) -> FloatArray:
    """(n, 2) points along a line, pt."""
    data = np.column_stack([np.asarray(values, np.float64) for values in line.get_data()])
    ends = scale * line.get_transform().transform(data[np.isfinite(data).all(axis=1)])
    if not len(ends):  # a line without a value
        return np.zeros((0, 2))
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(ends, axis=0), axis=1))])
    at = np.linspace(0.0, length[-1], int(length[-1] / _SAMPLE_PT) + 2)
    return np.column_stack([np.interp(at, length, ends[:, axis]) for axis in range(2)])


def _marks(line: Line2D, scale: float) -> FloatArray:
    """(n, 2, 2) least and greatest corners of the markers at all points of a line, pt."""
    if line.get_marker() in ("None", None) or line.get_markevery() is not None:
        return np.zeros((0, 2, 2))
    points = scale * line.get_transform().transform(np.column_stack(line.get_data()))
    radius = 0.5 * line.get_markersize()
    return np.stack([points - radius, points + radius], axis=1)


def _map(points: FloatArray, size: FloatArray) -> NDArray[np.int64]:
    """Number of cells with points in the rectangle from the origin to each cell of 1 pt."""
    cells = np.zeros(np.ceil(size).astype(np.int64) + 2, np.int64)
    cells[tuple(points.astype(np.int64).T + 1)] = 1
    return np.asarray(cells.cumsum(axis=0).cumsum(axis=1))


def _any_inside(counts: NDArray[np.int64], low: FloatArray, high: FloatArray) -> NDArray[np.bool_]:
    """(k,) for each of k boxes, True if any point of a map lies inside."""
    most = np.array(counts.shape) - 1
    (x, y), (right, top) = (
        np.clip(np.floor(ends).astype(np.int64) + more, 0, most).T
        for ends, more in ((low, 0), (high, 1))
    )
    inside = counts[right, top] - counts[x, top] - counts[right, y] + counts[x, y]
    return np.asarray(inside > 0)


def _best_place(
    path: FloatArray,
    half: FloatArray,
    maps: Sequence[NDArray[np.int64]],
    boxes: Sequence[FloatArray],
    marks: Sequence[FloatArray],
) -> tuple[float, FloatArray, FloatArray]:
    """Cost of the best place of a name, its anchor on the line, and the name's centre, pt.

    The cost is the distance from the line, and more where the name could be taken for that of
    another line. It is infinite if every place covers something.

    Args:
        path: (n, 2) points of the line, from the lower left corner of the panel.
        half: (2,) half width and height of the name.
        maps: maps of the line, see `_map`, and of each of the others.
        boxes: least and greatest corners (2, 2) of texts and leaders that are there.
        marks: corners (2, 2) of markers, which a leader may touch.
    """
    starts = path[::_ANCHOR_STEP]
    steps = (_DISTANCES_PT[:, None] * _DIRECTIONS[:, None]).reshape(-1, 2)
    to_centres = steps + np.repeat(_DIRECTIONS * half, len(_DISTANCES_PT), axis=0)
    anchors, steps = np.repeat(starts, len(steps), axis=0), np.tile(steps, (len(starts), 1))
    centres = anchors + np.tile(to_centres, (len(starts), 1))
    low, high = centres - half - _MARGIN_PT, centres + half + _MARGIN_PT
    leaders = np.sort(np.stack([anchors, anchors + steps]), axis=0)
    free = ((low >= 0.0) & (high <= np.array(maps[0].shape) - 2)).all(axis=1)
    for least, most in (*boxes, *marks):
        free &= (low > most).any(axis=1) | (high < least).any(axis=1)
    for least, most in boxes:
        free &= (leaders[0] > most).any(axis=1) | (leaders[1] < least).any(axis=1)
    for counts in maps:
        free &= ~_any_inside(counts, low, high)
    if not free.any():
        return np.inf, half, half
    anchors, centres, leaders = anchors[free], centres[free], leaders[:, free]
    cost = (leaders[1] - leaders[0]).sum(axis=1)
    for counts in maps[1:]:
        cost += _CROSSED_PT * _any_inside(counts, leaders[0] - _NEAR_PT, leaders[1] + _NEAR_PT)
        cost += _CONFUSED_PT * _any_inside(counts, anchors - _NEAR_PT, anchors + _NEAR_PT)
    best = int(np.argmin(cost))
    return float(cost[best]), anchors[best], centres[best]
