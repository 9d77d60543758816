"""Names of lines next to them, in their colours, in place of a legend."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.text import Annotation
from numpy.typing import NDArray

from vergence.eval.reporting.labels import as_float_pair
from vergence.models.parts import FloatArray

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

    Args:
        *panels: axes with the same lines, after the layout of their figure.
        **style: style of the texts, see `Axes.annotate`.

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
    """The names of a panel's lines, written next to them as far as there is room.

    Args:
        panel: axes, after the layout.
        style: style of the texts.
    """

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
