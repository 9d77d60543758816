"""Short texts beside points of a figure, each where it covers no other."""

from collections.abc import Iterable

import numpy as np
from matplotlib.axes import Axes

from vergence.models.parts import FloatArray


def page_point(point: FloatArray) -> tuple[float, float]:
    """A point of the page, as matplotlib's types want it."""
    return float(point[0]), float(point[1])


class Labels:
    """Short texts beside points, each where it covers no other.

    Args:
        panel: where they stand.
    """

    def __init__(self, panel: Axes) -> None:
        self._panel = panel
        self._texts: list[tuple[FloatArray, str, str, FloatArray]] = []
        self._points: list[tuple[FloatArray, float]] = []

    def add(self, point: FloatArray, text: str, colour: str, aside: Iterable[float]) -> None:
        """Ask for a text, which stands on the side that a direction (across, up) tells."""
        self._texts.append((np.array(point), text, colour, np.array(tuple(aside), np.float64)))

    def avoid(self, point: FloatArray, radius: float = 4.0) -> None:
        """Keep a point free, and as many points of type around it."""
        self._points.append((np.array(point), radius))

    def place(self) -> None:
        """Put all texts where they belong; call it once the limits of the panel are set."""
        to_points = 72.0 / self._panel.figure.dpi
        transform = self._panel.transData
        taken = [(to_points * transform.transform(p), np.full(2, r)) for p, r in self._points]
        for point, text, colour, aside in self._texts:
            anchor = to_points * transform.transform(point)
            half = np.array([3.2 * len(text) + 2.0, 7.0])
            wanted = transform.transform(point + 1e-3 * aside) - transform.transform(point)
            angle = float(np.arctan2(wanted[1], wanted[0]))
            offset = _free_offset(anchor, half, angle, taken)
            taken.append((anchor + offset, half))
            self._panel.annotate(
                text, page_point(point), page_point(offset), textcoords="offset points",
                color=colour, fontsize=11, ha="center", va="center", zorder=8,
            )  # fmt: skip


def _free_offset(
    anchor: FloatArray, half: FloatArray, angle: float, taken: list[tuple[FloatArray, FloatArray]]
) -> FloatArray:
    """The nearest place to a wanted direction, in points, where a box covers no other."""
    best: FloatArray = np.zeros(2)
    for distance in (8.0, 14.0, 22.0, 32.0, 44.0):
        for turn in (0.0, 0.6, -0.6, 1.2, -1.2, 1.8, -1.8, 2.5, -2.5, 3.14):
            direction = np.array([np.cos(angle + turn), np.sin(angle + turn)])
            best = direction * (distance + np.abs(direction) @ half - 4.0)
            if all((np.abs(anchor + best - at) >= half + other).any() for at, other in taken):
                return best
    return best
