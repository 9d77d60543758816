"""The picture of located targets: what both eyes saw, and where it is in space."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from vergence.eval.reporting.style import BLUE, GREY, ORANGE, new_figure, styled
from vergence.eval.sight.detections_figure import Colours, draw_detections, outline
from vergence.eval.sight.locate import LocateResult
from vergence.eval.sight.located import Located
from vergence.eval.sight.spacing import MM
from vergence.files import whole_file
from vergence.models.joints import EYE_NAMES
from vergence.models.parts import FloatArray

_VIEWS: Final = (
    ("from above", 0, 2, "x (mm), right", "z (mm), forward"),
    ("from the right", 2, 1, "z (mm), forward", "y (mm), down"),
)
"""Title, axis of N across and up the page, and their labels; y points down the page."""
_EYES: Final = (BLUE, ORANGE)
_VISIBLE_PT: Final = 2.0
"""Half axis of an ellipse, points of type, from which on it is seen beside its point."""
_SCALES: Final = (1, 3, 10, 30)
"""How many sigma an ellipse may be drawn at."""
_WIDTH: Final = 12.5
"""Of the figure, inches."""


def draw_located(result: LocateResult, path: Path) -> None:
    """Draw what was located to a PNG file.

    Args:
        result: of `locate`.
        path: the file; one of that name is replaced. Its folder exists.

    Raises:
        OSError: it cannot be written.
    """
    with styled():
        figure = compose(result)
        with whole_file(path) as partial:
            figure.savefig(partial, format="png", dpi=110, metadata={"Software": None})


def compose(result: LocateResult) -> Figure:
    """The picture, laid out.

    Args:
        result: of `locate`.
    """
    shown, colours = result.shown, Colours()
    tall = max(each.image.shape[0] / each.image.shape[1] for each in shown)
    top = 0.5 * _WIDTH * tall + 0.4
    with styled():
        figure = new_figure(_WIDTH, top + 5.4)
        grid = figure.add_gridspec(2, 2, height_ratios=(top, 5.4))
        for eye, name in enumerate(EYE_NAMES):
            panel = figure.add_subplot(grid[0, eye])
            draw_detections(panel, shown[eye].image, shown[eye].found, colours)
            panel.set_title(f"{name}: {shown[eye].path.name}", color=_EYES[eye])
        seen = [one for one in result.located if one.valid.any()]
        eyes = np.concatenate(
            [MM * result.head.camera_poses(q)[:, :3, 3] for q in result.angles.values()]
        )
        panels = [figure.add_subplot(grid[1, column]) for column in range(2)]
        for panel, (title, across, up, xlabel, ylabel) in zip(panels, _VIEWS, strict=True):
            _draw_view(panel, seen, eyes, (across, up), colours)
            panel.set(xlabel=xlabel, ylabel=ylabel, title=title)
        if seen:
            figure.draw_without_rendering()  # ellipses are scaled to the panels' final size
            _draw_sigma(panels, seen, colours)
        figure.suptitle(_heading(result, seen), fontsize=13)
    return figure


def _heading(result: LocateResult, seen: Sequence[Located]) -> str:
    count = len({one.pair for one in seen})
    names = list(dict.fromkeys(str(one.target) for one in seen))
    what = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
    if not seen:
        return f"head {result.head.name}: nothing found in both images of a pair"
    pairs = f"{count} of {len(result.pairs)} pairs" if len(result.pairs) > 1 else seen[0].pair
    return f"head {result.head.name}: {what}, {pairs}"


def _draw_view(
    panel: Axes, seen: Sequence[Located], eyes: FloatArray, axes: tuple[int, int], colours: Colours
) -> None:
    for eye, name in enumerate(EYE_NAMES):
        panel.plot(*eyes[eye::2][:, axes].T, "s", color=_EYES[eye], ms=8, label=f"{name} eye")
    many = len({one.pair for one in seen}) > 1
    for one in seen:
        points, colour = MM * one.fix.point[:, axes], colours.of(one.target)
        line = outline(one.target, points)
        panel.plot(*line.T, lw=1.0, alpha=0.6 if many else 1.0, color=colour)
        panel.plot(*points.T, ".", ms=2.0 if many else 4.0, color=colour)
        if not many:
            for place in eyes[:2][:, axes]:
                panel.plot(
                    *np.stack([place, MM * one.centre.point[list(axes)]]).T, ":", color=GREY, lw=1.0
                )
    panel.set_aspect("equal", adjustable="datalim")
    if axes[1] == 1:
        panel.invert_yaxis()
    panel.margins(0.08)
    panel.legend(loc="best", fontsize=10)


def _draw_sigma(panels: Sequence[Axes], seen: Sequence[Located], colours: Colours) -> None:
    """Ellipses at outermost corners, of one sigma or of as many as can be seen, if any can."""
    chosen = [
        (MM * one.fix.point[corner], MM**2 * one.fix.covariance[corner], one)
        for one in seen
        for corner in _outermost(one)
    ]
    if not chosen:
        return
    largest = np.median([np.sqrt(np.linalg.eigvalsh(c)[-1]) for _, c, _ in chosen])
    panel = panels[0]
    ends = panel.transData.transform([(0.0, 0.0), (largest, 0.0)])
    size_pt = (ends[1, 0] - ends[0, 0]) * 72.0 / panel.figure.dpi
    scale = next((s for s in _SCALES if s * size_pt >= _VISIBLE_PT), None)
    if scale is None:
        return
    for panel, (_, across, up, _, _) in zip(panels, _VIEWS, strict=True):
        for point, covariance, one in chosen:
            flat = covariance[np.ix_((across, up), (across, up))]
            values, vectors = np.linalg.eigh(flat)
            width, height = 2.0 * scale * np.sqrt(np.maximum(values, 0.0))
            ellipse = Ellipse(
                (point[across], point[up]),
                width,
                height,
                angle=np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])),
                fill=False,
                edgecolor=colours.of(one.target),
                lw=0.8,
                alpha=0.8,
            )
            panel.add_patch(ellipse)
        panel.set_title(f"{panel.get_title()}; ellipses: {scale} sigma")


def _outermost(one: Located) -> list[int]:
    """The corners with an answer that lie farthest out along the diagonals of the board."""
    valid = np.flatnonzero(one.valid)
    x, y = one.target.corners_m[valid].T
    ends = [valid[along.argmin()] for along in (x + y, y - x, -x - y, x - y)]
    return [int(end) for end in dict.fromkeys(ends)]
