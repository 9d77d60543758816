"""Figure of one gaze: the eyes' images, the errors over time, and the optical axes."""

from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from vergence.eval.gaze import GazeResult
from vergence.eval.gaze_trajectory import MM
from vergence.eval.reporting.labels import Labels, as_float_pair
from vergence.eval.reporting.line_labels import label_lines
from vergence.models.joints import EYE_NAMES
from vergence.models.parts import FloatArray

_COLOURS = ("#1f6fb4", "#d1571b")
_MOST_MAGNIFIED_FRACTION: Final = 0.12
"""Largest half width of the magnified part, as a fraction of the image's width; wider parts are not
magnified (chosen: detail against clutter)."""
_MAGNIFIED_SIDE: Final = 0.47
"""Side of a magnified part, as a fraction of the height for an image (chosen)."""
_WIDTH, _HEIGHT = 12.0, 9.8  # inches (chosen)
_PANELS: Final = (
    (0.8, 5.05, 5.0, 4.05), (6.8, 5.05, 5.0, 4.05), (0.8, 0.55, 5.0, 3.3), (6.8, 0.55, 5.0, 3.3),
)  # fmt: skip
"""Left, bottom, width and height of the panels, inches (chosen)."""
_LEAST_DRAWN_ERROR_PX: Final = 1e-3
"""Least drawn error, px; smaller errors are drawn as this (chosen: far below one that
matters, on a logarithmic axis)."""
_GREEN, _GREY = "#14803c", "#666666"
_STYLE: Any = {
    "font.size": 11,
    "axes.titlesize": 12,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "svg.hashsalt": "vergence",
}


def draw_gaze(result: GazeResult, path: Path) -> None:
    """Draw a gaze into a PNG file.

    Args:
        result: the gaze.
        path: the file.
    """
    with matplotlib.rc_context(_STYLE):
        compose_gaze(result).savefig(path)


def compose_gaze(result: GazeResult) -> Figure:
    """Draw a gaze.

    Args:
        result: the gaze.

    Returns:
        Both eyes, and below them the errors and the optical axes from above. Without ground truth
        the target is left out, without images the images.
    """
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(_WIDTH, _HEIGHT), dpi=110)
        FigureCanvasAgg(figure)
        _draw_eyes(figure, result)
        _draw_errors(_panel(figure, *_PANELS[2]), result)
        _draw_axes(_panel(figure, *_PANELS[3]), result)
        x, y, z = result.config.target_mm
        gain = result.config.gain
        law = result.config.controller + ("" if gain is None else f" with gain {gain:g}")
        target = f", target at ({x:g}, {y:g}, {z:g}) mm" if result.has_truth else ""
        figure.suptitle(f"{result.head.name} head, {law}{target}", fontsize=14, y=0.988)
    return figure


def _panel(figure: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
    """Axes at a place in inches; no layout is computed, which would take longer than drawing."""
    return figure.add_axes((left / _WIDTH, bottom / _HEIGHT, width / _WIDTH, height / _HEIGHT))


def _columns(result: GazeResult, what: str, eye: int) -> FloatArray:
    name = EYE_NAMES[eye]
    columns = [f"{what}_{name}_{axis}_px" for axis in "uv"]
    return np.asarray(result.trajectory[columns].to_numpy())


def _draw_eyes(figure: Figure, result: GazeResult) -> None:
    """Draw both eyes' images, magnified alike if their marks take up a small part of them."""
    paths = [
        _columns(result, "true_pixel" if result.has_truth else "pixel", eye) for eye in range(2)
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
        left, bottom, width, height = _PANELS[eye]
        scale = min((width, height) / sizes[eye])  # inches per px
        used = scale * sizes[eye]
        place = (left + 0.5 * (width - used[0]), bottom + 0.5 * (height - used[1]), *used)
        axes = _panel(figure, *place)
        axes.set(
            xlim=(-0.5, sizes[eye, 0] - 0.5), ylim=(sizes[eye, 1] - 0.5, -0.5),
            xlabel="u (px)", ylabel="v (px)",
            title=f"{EYE_NAMES[eye]} eye, {_what_is_shown(result)}",
        )  # fmt: skip
        axes.spines[:].set_visible(result.images is None)
        _draw_marks(axes, result, eye, path)
        named = axes
        if corner is not None:
            side = _MAGNIFIED_SIDE * height * np.array([1.0 / used[0], 1.0 / used[1]])
            low = 0.01 + np.array(corner) * (0.98 - side)
            named = axes.inset_axes((*low, *side))
            (u, v) = middles[eye]
            named.set(xlim=(u - half, u + half), ylim=(v + half, v - half), xticks=[], yticks=[])
            named.spines[:].set(visible=True, color=_COLOURS[eye], linewidth=1.5)
            _draw_marks(named, result, eye, path)
            axes.indicate_inset_zoom(named, edgecolor=_COLOURS[eye], alpha=1.0)
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
            extent=(-0.5, width - 0.5, height - 0.5, -0.5),
        )  # fmt: skip
    halo = [withStroke(linewidth=4.0, foreground="white")]
    axes.plot(*path.T, color=_COLOURS[eye], lw=2.0, path_effects=halo)
    axes.plot(*path[:1].T, "o", color=_COLOURS[eye], ms=8, mfc="white", mew=2)
    axes.plot(
        *result.head.cameras.principal[eye], "+", color="black", ms=24, mew=1.4, zorder=5,
        path_effects=[withStroke(linewidth=2.6, foreground="white")],
    )  # fmt: skip
    axes.plot(*_last_detection(result, eye).T, "x", color=_GREEN, ms=10, mew=2.4, zorder=6)
    axes.axis(limits)


def _last_detection(result: GazeResult, eye: int) -> FloatArray:
    """(1, 2) the last pixels detected by an eye, or (0, 2) if there are none."""
    seen = _columns(result, "pixel", eye)
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
        (point, "last detection", _GREEN, (away[0], 1.0)) for point in _last_detection(result, eye)
    ]
    followed = "target's path,\nfrom time zero" if result.has_truth else "detections' path"
    names += [(point, followed, _COLOURS[eye], as_float_pair(away)) for point in path[:1]]
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


def _draw_errors(axes: Axes, result: GazeResult) -> None:
    time = result.trajectory["time_s"].to_numpy()
    what, title, kind = "true_error", "pixel error, at present", "true"
    if not result.has_truth:
        what, title, kind = "measured_error", "pixel error, in the newest image", "measured"
    for eye, name in enumerate(EYE_NAMES):
        norm = np.linalg.norm(_columns(result, what, eye), axis=1)
        style = ("-", (0, (5, 2)))[eye]
        axes.plot(
            time,
            np.maximum(norm, _LEAST_DRAWN_ERROR_PX),
            color=_COLOURS[eye],
            ls=style,
            lw=2,
            label=f"{name} eye",
        )
    scale: dict[str, Any] = {"yscale": "log", "ylim": (_LEAST_DRAWN_ERROR_PX, None)}
    if result.has_residual:
        title = _mark_least_error(axes, result)
        if result.residual_px > 1.0:  # an error that ends far from zero needs no logarithmic scale
            scale = {"ylim": (0.0, None)}
    else:
        _mark_bands(axes, result)
    appeared = "the target appeared" if result.has_truth else "the start"
    axes.set(
        **scale,
        xlim=(0.0, time[-1]),
        xlabel=f"time since {appeared} (s)",
        ylabel=f"pixel error ({kind}), px",
        title=title,
    )
    if not label_lines(axes):
        axes.legend()


def _mark_bands(axes: Axes, result: GazeResult) -> None:
    said = []
    for band, settled in _settle_times(result):
        axes.axhline(band, color=_GREY, lw=0.9, ls=":")
        if np.isfinite(settled):
            axes.plot(settled, band, "o", color=_GREEN, ms=7, zorder=5)
        said.append(f"{band:g} px {_after(settled)}")
    if result.has_truth:
        _say(axes, "\n".join(["settled to", *said]), 0.86)


def _mark_least_error(axes: Axes, result: GazeResult) -> str:
    """Draw lines at both eyes' least errors, and the settle times to them; return the title."""
    for eye, least in enumerate(np.linalg.norm(result.residual, axis=-1)):
        axes.axhline(least, color=_COLOURS[eye], lw=1.2, ls=":")
        axes.get_lines()[eye].set_label(f"{EYE_NAMES[eye]} eye, least {least:.3g} px")
    said = [f"within {band:g} px of the least {_after(at)}" for band, at in _settle_times(result)]
    _say(axes, "\n".join(said), 0.2)
    return f"{result.limitation}\nleast that the actuators allow: " + (
        f"{result.residual_px:.3g} px in the worse eye"
    )


def _settle_times(result: GazeResult) -> tuple[tuple[float, float], ...]:
    return (1.0, result.settle_1px_s), (0.5, result.settle_05px_s)


def _after(settled: float) -> str:
    return f"after {settled:.3f} s" if np.isfinite(settled) else "never"


def _say(axes: Axes, text: str, top: float) -> None:
    axes.text(
        0.98, top, text, transform=axes.transAxes, color=_GREEN, ha="right", va="top",
        linespacing=1.4, bbox={"facecolor": "white", "edgecolor": "none", "pad": 2.0},
    )  # fmt: skip


def _draw_axes(axes: Axes, result: GazeResult) -> None:
    """Draw the two optical axes from above, z upwards, with the target and the fix by gaze."""
    poses = result.head.camera_poses(result.positions)
    fix = result.gaze_fix
    # without ground truth the view reaches as far as the fix, or 1 m if there is none
    target = MM * (result.true_target_m if result.has_truth else fix.point[0])
    if not np.isfinite(target).all():
        target = np.array([0.0, 0.0, MM])
    for eye, name in enumerate(EYE_NAMES):
        origin, direction = MM * poses[eye, :3, 3], poses[eye, :3, 2]
        end = origin + direction * 1.15 * (target[2] - origin[2]) / direction[2]
        axes.plot(
            [origin[0], end[0]], [origin[2], end[2]], color=_COLOURS[eye], lw=2,
            ls=("-", (0, (5, 2)))[eye], label=f"{name} optical axis",
        )  # fmt: skip
        axes.plot(origin[0], origin[2], "s", color=_COLOURS[eye], ms=9)
    if result.has_truth:
        axes.plot(
            target[0], target[2], "o", ms=15, mfc="none", color="black", mew=1.5, label="target"
        )
    if fix.valid[0]:
        point = MM * fix.point[0]
        axes.plot(point[0], point[2], "x", color=_GREEN, ms=9, mew=2.2, label="fix by gaze")
    span = max(0.3 * abs(target[2]), abs(target[0]) + 0.2 * abs(target[2]), 120.0)
    axes.set(
        xlim=(-span, span),
        ylim=(-0.06 * target[2], 1.3 * target[2]),
        xlabel="x (mm)",
        ylabel="z (mm)",
    )
    there = np.isfinite(result.settle_1px_s) and not result.has_residual
    cross = ("cross at the target" if there else "cross") if fix.valid[0] else "do not cross"
    axes.set_title(f"from above: the optical axes {cross}\n{_fix_text(result)}")
    if not label_lines(axes):
        axes.legend()


def _fix_text(result: GazeResult) -> str:
    parts = []
    for name, fix in (("gaze", result.gaze_fix), ("ITPC", result.view_fix)):
        if fix.valid[0] and not result.has_truth:
            x, y, z = MM * fix.point[0]
            parts.append(f"{name} at ({x:z.1f}, {y:z.1f}, {z:z.1f}) mm")
        elif fix.valid[0]:
            distance = MM * float(np.linalg.norm(fix.point[0] - result.true_target_m))
            parts.append(f"{name} {distance:.3f} mm off")
        else:
            parts.append(f"{name} found no point")
    return (", " if result.has_truth else "\n").join(parts)
