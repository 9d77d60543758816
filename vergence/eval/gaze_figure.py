"""Figure of one gaze: the eyes' images, the errors over time, and the optical axes."""

from pathlib import Path
from typing import Any, Final

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vergence.eval.gaze import GazeResult
from vergence.eval.gaze_trajectory import MM
from vergence.models.joints import EYE_NAMES
from vergence.models.parts import FloatArray

_COLOURS = ("#1f6fb4", "#d1571b")
_MOST_MAGNIFIED_FRACTION: Final = 0.15
"""Largest half width of the magnified part, as a fraction of the image's width; wider parts are not
magnified (chosen: detail against clutter)."""
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
        figure = Figure(figsize=(12.0, 10.2), dpi=110, layout="constrained")
        FigureCanvasAgg(figure)
        grid = figure.add_gridspec(2, 2, height_ratios=(1.0, 0.85))
        for eye in range(2):
            _draw_eye(figure.add_subplot(grid[0, eye]), result, eye)
        _draw_errors(figure.add_subplot(grid[1, 0]), result)
        _draw_axes(figure.add_subplot(grid[1, 1]), result)
        x, y, z = result.config.target_mm
        gain = result.config.gain
        law = result.config.controller + ("" if gain is None else f" with gain {gain:g}")
        target = f", target at ({x:g}, {y:g}, {z:g}) mm" if result.has_truth else ""
        figure.suptitle(f"{result.head.name} head, {law}{target}", fontsize=14)
    return figure


def _columns(result: GazeResult, what: str, eye: int) -> FloatArray:
    name = EYE_NAMES[eye]
    columns = [f"{what}_{name}_{axis}_px" for axis in "uv"]
    return np.asarray(result.trajectory[columns].to_numpy())


def _draw_eye(axes: Axes, result: GazeResult, eye: int) -> None:
    image = None if result.images is None else result.images.of(eye)
    width, height = result.head.cameras.size[eye]
    extent = (-0.5, width - 0.5, height - 0.5, -0.5)
    seen = _columns(result, "pixel", eye)
    seen = seen[np.isfinite(seen).all(axis=1)]
    path = _columns(result, "true_pixel", eye) if result.has_truth else seen
    centre = result.head.cameras.principal[eye]
    middle = 0.5 * (path[0] + centre) if len(path) else centre
    half = max(float(np.abs(path - middle).max(initial=0.0)) + 60.0, 0.05 * width)
    panels = [axes]
    if half < _MOST_MAGNIFIED_FRACTION * width:
        left = 0.01 if middle[0] > 0.55 * width else 0.60
        zoom = axes.inset_axes((left, 0.51, 0.39, 0.47))
        zoom.spines[:].set_visible(True)
        panels.append(zoom)
    for panel in panels:
        if image is not None:
            panel.imshow(image, cmap="gray", vmin=0, vmax=255, extent=extent, aspect="auto")
        followed = "target" if result.has_truth else "detections"
        panel.plot(*path.T, color=_COLOURS[eye], lw=2.0, label=f"path of the {followed}")
        panel.plot(
            *path[:1].T, "o", color=_COLOURS[eye], ms=8, mfc="white", mew=2,
            label="at time zero" if result.has_truth else "first detection",
        )  # fmt: skip
        panel.plot(*centre, "+", color="black", ms=24, mew=1.4, label="principal point", zorder=5)
        if len(seen):
            panel.plot(
                *seen[-1], "x", color=_GREEN, ms=10, mew=2.4, label="last detection", zorder=6
            )
    if len(panels) > 1:
        zoom.set(
            xlim=(middle[0] - half, middle[0] + half),
            ylim=(middle[1] + half, middle[1] - half),
            xticks=[],
            yticks=[],
            aspect="equal",
        )
        axes.indicate_inset_zoom(zoom, edgecolor="black", alpha=0.8)
    axes.set(
        xlim=(-0.5, width - 0.5),
        ylim=(height - 0.5, -0.5),
        xlabel="u (px)",
        ylabel="v (px)",
        aspect="equal",
        title=f"{EYE_NAMES[eye]} eye, {_what_is_shown(result)}",
    )
    axes.spines[:].set_visible(image is None)
    handles, labels = axes.get_legend_handles_labels()
    cross = Line2D([], [], color="black", marker="+", ms=11, mew=1.4, ls="none")
    handles[labels.index("principal point")] = cross
    axes.legend(handles, labels, loc="lower left", fontsize=10, frameon=True, framealpha=0.85)


def _what_is_shown(result: GazeResult) -> str:
    if result.images is None:
        return "detections (no images)"
    return "drawn for the last posture (no camera)" if result.images.drawn else "last image"


def _draw_errors(axes: Axes, result: GazeResult) -> None:
    time = result.trajectory["time_s"].to_numpy()
    what, title = "true_error", "true pixel error, at present"
    if not result.has_truth:
        what, title = "measured_error", "measured pixel error, in the newest image"
    for eye, name in enumerate(EYE_NAMES):
        norm = np.linalg.norm(_columns(result, what, eye), axis=1)
        style = ("-", (0, (5, 2)))[eye]
        axes.plot(
            time,
            np.maximum(norm, _LEAST_DRAWN_ERROR_PX),
            color=_COLOURS[eye],
            ls=style,
            lw=2,
            label=name,
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
        ylabel="pixel error (px)",
        title=title,
    )
    axes.legend(title="eye", loc="upper right")


def _mark_bands(axes: Axes, result: GazeResult) -> None:
    said = []
    for band, settled in _settle_times(result):
        axes.axhline(band, color=_GREY, lw=0.9, ls=":")
        if np.isfinite(settled):
            axes.plot(settled, band, "o", color=_GREEN, ms=7, zorder=5)
        said.append(f"{band:g} px {_after(settled)}")
    if result.has_truth:
        _say(axes, "\n".join(["settled to", *said]), 0.72)


def _mark_least_error(axes: Axes, result: GazeResult) -> str:
    """Draw lines at both eyes' least errors, and the settle times to them; return the title."""
    for eye, least in enumerate(np.linalg.norm(result.residual, axis=-1)):
        axes.axhline(least, color=_COLOURS[eye], lw=1.2, ls=":")
        axes.get_lines()[eye].set_label(f"{EYE_NAMES[eye]}, least {least:.3g} px")
    said = [f"within {band:g} px of the least {_after(at)}" for band, at in _settle_times(result)]
    _say(axes, "\n".join(said), 0.2)
    return f"true pixel error: {result.limitation}\nleast that the actuators allow: " + (
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
            target[0], target[2], "o", ms=15, mfc="none", mec="black", mew=1.5, label="target"
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
    axes.legend(loc="upper left" if target[0] > 0.0 else "upper right", fontsize=10)


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
