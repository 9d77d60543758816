"""Figure of one gaze: the eyes' images, the errors over time, and the optical axes."""

from pathlib import Path
from typing import Any, Final

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from vergence.eval.gaze import GazeResult
from vergence.eval.gaze_eyes_figure import EYE_COLOURS, GREEN, add_panel, columns_of, draw_eyes
from vergence.eval.gaze_trajectory import MM
from vergence.models.parts import EYE_NAMES
from vergence.reporting.style import label_lines, legend_below, log_axis

_WIDTH: Final = 12.0  # inches (chosen)
_ABOVE_IMAGES: Final = 0.7
"""Height above the images, for titles, inches (chosen)."""
_PANELS: Final = (
    (0.8, 5.25, 5.0, 4.05), (6.8, 5.25, 5.0, 4.05), (0.8, 0.75, 5.0, 3.3), (6.8, 0.75, 5.0, 3.3),
)  # fmt: skip
"""Left, bottom, width and greatest height of the panels, inches (chosen)."""
_LEAST_DRAWN_ERROR_PX: Final = 1e-3
"""Least drawn error, px; smaller errors are drawn as this (chosen: far below one that
matters, on a logarithmic axis)."""
_COMPRESSION: Final = 3
"""Level of zlib, 0 to 9 (chosen: half the time of level 6, for a file larger by a sixth)."""
_GREY = "#666666"
_STYLE: Any = {
    "font.size": 11,
    "axes.titlesize": 12,
    "axes.titley": 1.0,
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
        compose_gaze(result).savefig(path, pil_kwargs={"compress_level": _COMPRESSION})


def compose_gaze(result: GazeResult) -> Figure:
    """Draw a gaze.

    Args:
        result: the gaze.

    Returns:
        Both eyes, and below them the errors and the optical axes from above. Without ground truth
        the target is left out, without images the images.
    """
    with matplotlib.rc_context(_STYLE):
        width, height = result.head.cameras.size.T  # wide images leave no room empty
        places = [
            (x, y, w, min(h, w * float((height / width).max()))) for x, y, w, h in _PANELS[:2]
        ]
        figure = Figure(figsize=(_WIDTH, places[0][1] + places[0][3] + _ABOVE_IMAGES), dpi=110)
        FigureCanvasAgg(figure)
        draw_eyes(figure, result, places)
        _draw_errors(add_panel(figure, *_PANELS[2]), result)
        _draw_axes(add_panel(figure, *_PANELS[3]), result)
        x, y, z = result.config.target_mm
        gain = result.config.gain
        law = result.config.controller + ("" if gain is None else f" with gain {gain:g}")
        target = f", target at ({x:.4g}, {y:.4g}, {z:.4g}) mm" if result.has_truth else ""
        figure.suptitle(f"{result.head.name}: {law}{target}", fontsize=14, y=0.988)
    return figure


def _draw_errors(axes: Axes, result: GazeResult) -> None:
    time = result.trajectory["time_s"]
    what, title, kind = "true_error", "pixel error, at present", "true"
    if not result.has_truth:
        what, title, kind = "measured_error", "pixel error, in the newest image", "measured"
    for eye, name in enumerate(EYE_NAMES):
        norm = np.linalg.norm(columns_of(result, what, eye), axis=1)
        style = ("-", (0, (5, 2)))[eye]
        axes.plot(
            time,
            np.maximum(norm, _LEAST_DRAWN_ERROR_PX),
            color=EYE_COLOURS[eye],
            ls=style,
            lw=2,
            label=f"{name} eye",
        )
    least = _LEAST_DRAWN_ERROR_PX
    if result.has_residual:
        title = _mark_least_error(axes, result)
        if result.residual_px > 1.0:  # an error that ends far from zero needs no logarithmic scale
            least = 0.0
    else:
        title += _mark_bands(axes, result)
    appeared = "the target appeared" if result.has_truth else "the start"
    if least:
        log_axis(axes)
        axes.yaxis.set_minor_locator(NullLocator())  # the axis spans decades: these ticks suffice
    axes.set(
        xlim=(0.0, time[-1]),
        ylim=(least, None),
        xlabel=f"time since {appeared} (s)",
        ylabel=f"pixel error ({kind}), px",
        title=title,
    )
    if not label_lines(axes):
        legend_below(axes, 2)


def _mark_bands(axes: Axes, result: GazeResult) -> str:
    """Draw the settling bands; return the settle times, for the title, where they are known."""
    for band, settled in _settle_times(result):
        axes.axhline(band, color=_GREY, lw=0.9, ls=":")
        if np.isfinite(settled):
            axes.plot(settled, band, "o", color=GREEN, ms=7, zorder=5)
    said = [f"to {band:g} px {_after(settled)}" for band, settled in _settle_times(result)]
    return f"\nsettled {', '.join(said)}" if result.has_truth else ""


def _mark_least_error(axes: Axes, result: GazeResult) -> str:
    """Draw lines at both eyes' least errors; return the title, with the settle times to them."""
    for eye, least in enumerate(np.linalg.norm(result.residual, axis=-1)):
        axes.axhline(least, color=EYE_COLOURS[eye], lw=1.2, ls=":")
        axes.get_lines()[eye].set_label(f"{EYE_NAMES[eye]} eye, least {least:.3g} px")
    said = [f"{band:g} px {_after(settled)}" for band, settled in _settle_times(result)]
    return f"{result.limitation}\nwithin, of the least possible, {', '.join(said)}"


def _settle_times(result: GazeResult) -> tuple[tuple[float, float], ...]:
    return (1.0, result.settle_1px_s), (0.5, result.settle_05px_s)


def _after(settled: float) -> str:
    return f"after {settled:.3f} s" if np.isfinite(settled) else "never"


def _draw_axes(axes: Axes, result: GazeResult) -> None:
    """Draw the two optical axes from above, z upwards, with the target and the fix by gaze."""
    poses = result.head.camera_poses(result.positions)
    fix = result.gaze_fix
    shown, by = (fix, "gaze") if fix.valid[0] else (result.view_fix, "ITPC")
    # without ground truth the view reaches as far as the fix, or 1 m if there is none
    target = MM * (result.true_target_m if result.has_truth else shown.point[0])
    if not np.isfinite(target).all():
        target = np.array([0.0, 0.0, MM])
    for eye, name in enumerate(EYE_NAMES):
        origin, direction = MM * poses[eye, :3, 3], poses[eye, :3, 2]
        end = origin + direction * 1.15 * (target[2] - origin[2]) / direction[2]
        axes.plot(
            [origin[0], end[0]], [origin[2], end[2]], color=EYE_COLOURS[eye], lw=2,
            ls=("-", (0, (5, 2)))[eye], label=f"{name} optical axis",
        )  # fmt: skip
        axes.plot(origin[0], origin[2], "s", color=EYE_COLOURS[eye], ms=9)
    if result.has_truth:
        axes.plot(
            target[0], target[2], "o", ms=15, mfc="none", color="black", mew=1.5, label="target"
        )
    span = max(0.3 * abs(target[2]), abs(target[0]) + 0.2 * abs(target[2]), 120.0)
    point, low, high = MM * shown.point[0], -0.06 * target[2], 1.3 * target[2]
    if shown.valid[0] and abs(point[0]) < span and low < point[2] < high:
        axes.plot(point[0], point[2], "x", color=GREEN, ms=9, mew=2.2, label=f"fix by {by}")
    axes.set(xlim=(-span, span), ylim=(low, high), xlabel="x (mm)", ylabel="z (mm)")
    there = np.isfinite(result.settle_1px_s) and not result.has_residual
    cross = ("cross at the target" if there else "cross") if fix.valid[0] else "do not cross"
    axes.set_title(f"from above: the optical axes {cross}\n{_fix_text(result)}")
    if not label_lines(axes):
        legend_below(axes, 4, fontsize=9, columnspacing=1.0)


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
