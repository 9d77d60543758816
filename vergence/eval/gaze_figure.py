"""The picture of one gaze: what the eyes saw, how the errors fell, where the axes cross."""

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vergence.eval.gaze import MM, GazeResult
from vergence.models.joints import EYE_NAMES
from vergence.models.parts import FloatArray

_COLOURS = ("#1f6fb4", "#d1571b")
_WORTH_MAGNIFYING = 0.15
"""Half width of the magnified part, by the image's, from which on nothing is magnified."""
_LEAST_PX = 1e-3
"""Errors below this are drawn as this."""
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
    """Draw a gaze to a PNG file.

    Args:
        result: the gaze.
        path: the file.
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
        figure.suptitle(
            f"{result.head.name} head, {law}, target at ({x:g}, {y:g}, {z:g}) mm",
            fontsize=14,
        )
        figure.savefig(path)


def _columns(result: GazeResult, what: str, eye: int) -> FloatArray:
    name = EYE_NAMES[eye]
    columns = [f"{what}_{name}_{axis}_px" for axis in "uv"]
    return np.asarray(result.trajectory[columns].to_numpy())


def _draw_eye(axes: Axes, result: GazeResult, eye: int) -> None:
    image = result.images[eye]
    height, width = image.shape
    extent = (-0.5, width - 0.5, height - 0.5, -0.5)
    path = _columns(result, "true_pixel", eye)
    centre = result.head.cameras.principal[eye]
    middle = 0.5 * (path[0] + centre)
    half = max(float(np.abs(path - middle).max()) + 60.0, 0.05 * width)
    panels = [axes]
    if half < _WORTH_MAGNIFYING * width:
        left = 0.01 if middle[0] > 0.55 * width else 0.60
        zoom = axes.inset_axes((left, 0.51, 0.39, 0.47))
        zoom.spines[:].set_visible(True)
        panels.append(zoom)
    for panel in panels:
        panel.imshow(image, cmap="gray", vmin=0, vmax=255, extent=extent, aspect="auto")
        panel.plot(*path.T, color=_COLOURS[eye], lw=2.0, label="path of the target")
        panel.plot(
            *path[0], "o", color=_COLOURS[eye], ms=8, mfc="white", mew=2, label="at time zero"
        )
        panel.plot(*centre, "+", color="black", ms=24, mew=1.4, label="principal point", zorder=5)
        seen = _columns(result, "pixel", eye)
        seen = seen[np.isfinite(seen).all(axis=1)]
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
        title=f"{EYE_NAMES[eye]} eye, last image",
    )
    handles, labels = axes.get_legend_handles_labels()
    cross = Line2D([], [], color="black", marker="+", ms=11, mew=1.4, ls="none")
    handles[labels.index("principal point")] = cross
    axes.legend(handles, labels, loc="lower left", fontsize=10, frameon=True, framealpha=0.85)


def _draw_errors(axes: Axes, result: GazeResult) -> None:
    time = result.trajectory["time_s"].to_numpy()
    what, title = "true_error", "true pixel error, at present"
    if not result.has_truth:
        what, title = "measured_error", "measured pixel error, in the newest image"
    beyond = result.residual if _has_residual(result) else np.zeros((2, 2))
    if beyond.any():
        title = f"true pixel error beyond the least, which is {result.residual_px:.3g} px"
    for eye, name in enumerate(EYE_NAMES):
        norm = np.linalg.norm(_columns(result, what, eye) - beyond[eye], axis=1)
        norm = np.maximum(norm, _LEAST_PX)
        style = ("-", (0, (5, 2)))[eye]
        axes.plot(time, norm, color=_COLOURS[eye], ls=style, lw=2, label=name)
    said = []
    for band, settled in ((1.0, result.settle_1px_s), (0.5, result.settle_05px_s)):
        axes.axhline(band, color=_GREY, lw=0.9, ls=":")
        if np.isfinite(settled):
            axes.plot(settled, band, "o", color=_GREEN, ms=7, zorder=5)
        said.append(f"{band:g} px after {settled:.3f} s" if np.isfinite(settled) else
                    f"{band:g} px never")  # fmt: skip
    if result.has_truth:
        axes.text(
        0.98, 0.72, "settled to\n" + "\n".join(said), transform=axes.transAxes, color=_GREEN,
        ha="right", va="top", linespacing=1.4,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 2.0},
    )  # fmt: skip
    axes.set(
        yscale="log",
        ylim=(_LEAST_PX, None),
        xlim=(0.0, time[-1]),
        xlabel="time since the target appeared (s)",
        ylabel="pixel error (px)",
        title=title,
    )
    axes.legend(title="eye", loc="upper right")


def _has_residual(result: GazeResult) -> bool:
    """Whether the eyes cannot look at the target so exactly that it would be seen in a picture."""
    return result.has_truth and result.residual_px > _LEAST_PX


def _draw_axes(axes: Axes, result: GazeResult) -> None:
    """The two optical axes from above, z upwards, with the fixes magnified beside them."""
    poses = result.head.camera_poses(result.positions)
    target = MM * result.truth_m if result.has_truth else np.array(result.config.target_mm)
    for eye, name in enumerate(EYE_NAMES):
        origin, direction = MM * poses[eye, :3, 3], poses[eye, :3, 2]
        end = origin + direction * 1.15 * (target[2] - origin[2]) / direction[2]
        axes.plot(
            [origin[0], end[0]], [origin[2], end[2]], color=_COLOURS[eye], lw=2,
            ls=("-", (0, (5, 2)))[eye], label=f"{name} optical axis",
        )  # fmt: skip
        axes.plot(origin[0], origin[2], "s", color=_COLOURS[eye], ms=9)
    axes.plot(target[0], target[2], "o", ms=15, mfc="none", mec="black", mew=1.5, label="target")
    fix = result.gaze
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
    where = "near" if _has_residual(result) else "at"
    cross = f"cross {where} the target" if fix.valid[0] else "do not cross"
    axes.set_title(f"from above: the optical axes {cross}\n{_fix_text(result)}")
    axes.legend(loc="upper left" if target[0] > 0.0 else "upper right", fontsize=10)


def _fix_text(result: GazeResult) -> str:
    parts = []
    for name, fix in (("gaze", result.gaze), ("ITPC", result.itpc)):
        if fix.valid[0] and not result.has_truth:
            x, y, z = MM * fix.point[0]
            parts.append(f"{name} at ({x:z.1f}, {y:z.1f}, {z:z.1f}) mm")
        elif fix.valid[0]:
            distance = MM * float(np.linalg.norm(fix.point[0] - result.truth_m))
            parts.append(f"{name} {distance:.3f} mm off")
        else:
            parts.append(f"{name} found no point")
    return ", ".join(parts)
