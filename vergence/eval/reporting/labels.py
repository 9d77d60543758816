"""Placement of short texts next to points of a figure, without overlaps."""

from collections.abc import Iterable, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.text import Annotation

from vergence.models.parts import FloatArray

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
    """Texts of a panel, which are placed next to their points without overlaps.

    Args:
        panel: axes of the texts.
    """

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
