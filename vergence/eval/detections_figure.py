"""Figures of photographs with their detections."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from vergence.files import atomic_file
from vergence.models.parts import FloatArray
from vergence.perception.finding import Photograph, tag_number
from vergence.reporting.style import as_float_pair, figure_style, new_figure
from vergence.vision import Detection
from vergence.vision.targets import PlanarTarget

COLOURS: Final = ("#00a2ff", "#ff7a00", "#00c060", "#d84bff", "#e8c000", "#ff4060")
"""Colours of targets, assigned in order; they stand out from grey images."""
_TITLE_PT: Final = 10.0
"""Font size of a panel's title, pt (chosen: legibility)."""
_LETTER_WIDTH: Final = 0.62
"""Estimated width of a letter as a fraction of the font size, slightly above the mean of file names
(chosen)."""
_NUMBER_PT: Final = (3.5, 12.0)
"""Least and largest font size of a tag's number, pt (chosen: legibility)."""


class TargetColours:
    """Assignment of a fixed colour to each target of a figure."""

    def __init__(self) -> None:
        self._given: dict[str, str] = {}

    def of(self, target: PlanarTarget) -> str:
        """The target's colour."""
        return self._given.setdefault(str(target), COLOURS[len(self._given) % len(COLOURS)])


def target_outline(target: PlanarTarget, corners: FloatArray) -> FloatArray:
    """The outermost corners of a target in order around it, without missing ones.

    Args:
        target: the board.
        corners: (n, k) its corners, in an image or in space; nan for a missing one.

    Returns:
        (m, k) a closed line, from the upper left corner clockwise.
    """
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
    panel: Axes, image: NDArray[np.uint8], found: Sequence[Detection], colours: TargetColours
) -> None:
    """Draw an image with its targets: corners, outline, upper left corner, and numbers of tags.

    Args:
        panel: axes to draw on.
        image: (height, width) grey levels.
        found: detections in the image.
        colours: colours of targets.
    """
    height, width = image.shape
    pt_per_px = 72.0 / panel.figure.dpi * panel.bbox.width / width
    panel.imshow(image, cmap="gray", vmin=0, vmax=255, interpolation="antialiased")
    for detection in found:
        target, corners = detection.target, detection.corners_px
        style: dict[str, Any] = {"color": colours.of(target)}
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
        number = str(tag_number(target)) if tag_number(target) is not None else ""
        if number:
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


def _title(name: str, found: Sequence[Detection], width_in: float) -> str:
    """An image's name and its detections, on two lines if they are too wide for one."""
    what = _what(found)
    line = f"{name}: {what}"
    if shorten_to_width(line, width_in, _TITLE_PT) == line:
        return line
    return "\n".join(shorten_to_width(part, width_in, _TITLE_PT) for part in (name, what))


def _what(found: Sequence[Detection]) -> str:
    """Summary of an image's detections: boards by name, and the number of tags."""
    boards = [str(one.target) for one in found if tag_number(one.target) is None]
    tags = len(found) - len(boards)
    count = [f"{tags} {'tag' if tags == 1 else 'tags'}"] if tags else []
    return ", ".join([*boards, *count]) or "nothing found"


def draw_photographs(photographs: Sequence[Photograph], path: Path) -> None:
    """Draw photographs next to each other into a PNG file.

    Args:
        photographs: one photograph or a few.
        path: the file, replaced if it exists; its folder must exist.

    Raises:
        OSError: the file cannot be written.
    """
    with figure_style():
        figure = compose_detections(photographs)
        with atomic_file(path) as partial:
            figure.savefig(partial, format="png", dpi=110, metadata={"Software": None})


def compose_detections(photographs: Sequence[Photograph]) -> Figure:
    """Compose the figure.

    Args:
        photographs: see `draw_photographs`.
    """
    columns = 1 if len(photographs) == 1 else 2 if len(photographs) <= 4 else 3
    across = {1: 9.0, 2: 6.2, 3: 4.6}[columns]
    tall = [image.shape[0] / image.shape[1] for _, image, _ in photographs]
    heights = [
        across * max(tall[start : start + columns]) + 0.5
        for start in range(0, len(photographs), columns)
    ]
    colours = TargetColours()
    with figure_style():
        figure = new_figure(across * columns, sum(heights))
        grid = figure.add_gridspec(len(heights), columns, height_ratios=heights)
        for place, (name, image, found) in enumerate(photographs):
            panel = figure.add_subplot(grid[divmod(place, columns)])
            draw_detections(panel, image, found, colours)
            panel.set_title(_title(name.name, found, across), fontsize=_TITLE_PT)
    return figure
