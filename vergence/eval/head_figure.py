"""The drawing by which a person checks a head: eyes, axes, fields of view, images."""

from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon, Rectangle

from vergence.eval.head_summary import HeadSummary, edge_rays, summarise
from vergence.eval.reporting.labels import Labels, page_point
from vergence.eval.reporting.style import BLACK, BLUE, GREEN, GREY, ORANGE, new_figure, styled
from vergence.files import whole_file
from vergence.models.head import HeadModel
from vergence.models.joints import EYE_NAMES
from vergence.models.parts import FloatArray
from vergence.vision.optics import EyeCamera

_COLOURS: Final = (BLUE, ORANGE)
_VIEWS: Final = (
    ("from above", 0, 2, "x (mm)", "z (mm), forward"),
    ("from the right", 2, 1, "z (mm), forward", "y (mm), down"),
    ("from behind", 0, 1, "x (mm)", "y (mm), down"),
)
"""Title, axis of N across and up the page, and their labels; y points down the page."""
_MM: Final = 1000.0


class _Geometry:
    """What the three views show, in N at rest, millimetres.

    Args:
        head: one head.
    """

    def __init__(self, head: HeadModel) -> None:
        rest = head.rest()
        poses = head.camera_poses(rest)
        self.eyes = _MM * poses[:, :3, 3]
        self.turns = poses[:, :3, :3]
        self.cameras = [EyeCamera.of(head, eye) for eye in range(2)]
        self.edges = [_edges(camera) for camera in self.cameras]
        from_base = np.linalg.inv(head.base_pose(rest))
        self.base = np.asarray(_MM * from_base[:3, 3], np.float64)
        placed: list[FloatArray] = []
        bodies = head.links.bodies()
        for body in bodies:
            angle = rest[body.joints[0]]
            turn = np.eye(4)
            turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
            parent = placed[body.parent] if body.parent >= 0 else from_base
            placed.append(parent @ body.pose @ turn)
        self.axes = [(_MM * pose[:3, 3], pose[:3, 2]) for pose in placed]
        self.has_neck = any(head.joints[:3])
        points = [*self.eyes, np.zeros(3), *(origin for origin, _ in self.axes)]
        if self.has_neck:
            points.append(self.base)
        low, high = np.min(points, axis=0), np.max(points, axis=0)
        self.baseline = float(np.linalg.norm(self.eyes[1] - self.eyes[0]))
        eye_axes = [a for a, body in zip(self.axes, bodies, strict=True) if body.joints[0] >= 3]
        self.nearby = np.array([*self.eyes, np.zeros(3), *(origin for origin, _ in eye_axes)])
        self.size = max(self.baseline, 0.8 * float((high - low).max()))
        self.low, self.high = low - 0.45 * self.size, high + 0.45 * self.size
        self.high[2] += 0.35 * self.size  # ahead, where the eyes look


def _edges(camera: EyeCamera) -> FloatArray:
    """(4, 3) rays in the camera of the middles of the left, right, upper and lower edge."""
    (u, v), (right, bottom) = camera.principal_px, (camera.width - 0.5, camera.height - 0.5)
    rays, _ = edge_rays(camera, np.array([[-0.5, v], [right, v], [u, -0.5], [u, bottom]]))
    return np.column_stack([rays, np.ones(4)])


def draw_head(head: HeadModel, path: Path, summary: HeadSummary | None = None) -> None:
    """Draw a head to a PNG file, to be checked by eye.

    Args:
        head: one head, not a population.
        path: the file; one of that name is replaced. Its folder exists.
        summary: of the head, where it is known already.

    Raises:
        OSError: it cannot be written.
    """
    summary = summary or summarise(head)
    shown = _Geometry(head)
    with styled():
        figure = new_figure(13.0, 10.4)
        grid = figure.add_gridspec(2, 2)
        for place, (title, across, up, *labels) in zip(
            ((0, 0), (0, 1), (1, 0)), _VIEWS, strict=True
        ):
            panel = figure.add_subplot(grid[place])
            _draw_view(panel, shown, across, up)
            panel.set(title=title, xlabel=labels[0], ylabel=labels[1])
        right = grid[1, 1].subgridspec(2, 1, height_ratios=(1.0, 0.95))
        _draw_images(figure.add_subplot(right[0]), shown)
        _write_joints(figure.add_subplot(right[1]), summary)
        figure.suptitle(
            f"{head.name}: baseline {summary.baseline_mm:.1f} mm, at rest, in frame N", fontsize=14
        )
        figure.draw_without_rendering()  # panels of equal axes fit only in the second layout
        with whole_file(path) as partial:
            figure.savefig(partial, format="png", dpi=110, metadata={"Software": None})


def _draw_view(panel: Axes, shown: _Geometry, across: int, up: int) -> None:
    plane = [across, up]
    length = 0.3 * shown.size
    labels = Labels(panel)
    towards = 1.0 if across == 2 else -1.0  # the reader, along the axis that is not on the page
    far = 4.0 * float((shown.high - shown.low).max())
    for eye, (origin, turn) in enumerate(zip(shown.eyes, shown.turns, strict=True)):
        colour, start = _COLOURS[eye], origin[plane]
        rays = shown.edges[eye] @ turn.T
        pair = rays[:2] if up == 2 else rays[2:]
        if {across, up} != {0, 1}:
            ends = [start + far * (ray / np.linalg.norm(ray))[plane] for ray in pair]
            panel.add_patch(
                Polygon([start, *ends], closed=True, facecolor=colour, alpha=0.10, linewidth=0.0)
            )
            for end in ends:
                panel.plot(*np.column_stack([start, end]), color=colour, lw=0.8, alpha=0.6)
        direction = turn[plane, 2]
        if np.linalg.norm(direction) > 0.1:
            end = start + far * direction
            panel.plot(*np.column_stack([start, end]), color=colour, lw=1.6, ls=(0, (6, 3)))
        panel.plot(*start, "s", color=colour, ms=8, zorder=6)
        labels.avoid(start)
        outside = -1.0 if eye == 0 else 1.0
        # behind the eye, where no line of sight is
        back = (
            (outside, -1.0) if up == 2 else (-1.0, 0.3 * outside) if across == 2 else (outside, 0.0)
        )
        labels.add(start, EYE_NAMES[eye], colour, back)
    _draw_frame(panel, np.zeros(3), length, plane, labels)
    for number, (origin, axis) in enumerate(shown.axes, start=1):
        ahead = towards * axis[3 - across - up]
        _draw_axis(panel, origin[plane], axis[plane], ahead, 0.5 * length, str(number), labels)
    if shown.has_neck:
        panel.plot(*shown.base[plane], "^", color=GREY, ms=9, zorder=5)
        labels.add(shown.base[plane], "base", GREY, (1.0, 0.0))
    low, high = shown.low[plane], shown.high[plane]
    _draw_baseline(panel, shown, plane)
    panel.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]) if up == 1 else (low[1], high[1]))
    panel.set_aspect("equal")
    labels.place()


def _draw_frame(
    panel: Axes, origin: FloatArray, length: float, plane: list[int], labels: Labels
) -> None:
    """The axes of N that lie in the plane of a view."""
    start = origin[plane]
    for axis, name in enumerate("xyz"):
        tip = origin.copy()
        tip[axis] += length
        if axis in plane:
            panel.annotate(
                "", page_point(tip[plane]), page_point(start),
                arrowprops={"arrowstyle": "-|>", "color": BLACK, "lw": 1.4, "shrinkA": 0,
                            "shrinkB": 0},
            )  # fmt: skip
            labels.add(tip[plane], name, BLACK, page_point((tip - origin)[plane]))
            for share in np.linspace(0.2, 1.0, 5):
                labels.avoid((origin + share * (tip - origin))[plane])
    labels.add(start, "N", BLACK, (-1.0, -1.0))
    labels.avoid(start)


def _draw_axis(
    panel: Axes, start: FloatArray, direction: FloatArray, towards: float, half: float,
    text: str, labels: Labels,
) -> None:  # fmt: skip
    """A joint's axis: an arrow through its origin, or a ring with its point or its feathers."""
    if np.linalg.norm(direction) < 0.2:
        panel.plot(*start, "o", color=GREEN, ms=13, mfc="none", mew=1.6, zorder=5)
        panel.plot(*start, "o" if towards > 0.0 else "x", color=GREEN, ms=4 if towards > 0 else 8)
        labels.avoid(start, 8.0)
        labels.add(start, text, GREEN, (0.7, 0.7))
        return
    ends = np.array([start - half * direction, start + half * direction])
    panel.plot(*ends.T, color=GREEN, lw=2.0, zorder=4)
    panel.plot(*start, "o", color=GREEN, ms=5, zorder=5)
    panel.annotate(
        "", page_point(ends[1]), page_point(start),
        arrowprops={"arrowstyle": "-|>", "color": GREEN, "lw": 1.6, "shrinkA": 0, "shrinkB": 0},
    )  # fmt: skip
    for share in np.linspace(0.0, 1.0, 7):
        labels.avoid(ends[0] + share * (ends[1] - ends[0]))
    labels.add(ends[1], text, GREEN, page_point(direction))


def _draw_baseline(panel: Axes, shown: _Geometry, plane: list[int]) -> None:
    """The distance between the eyes, as a dimension line beside them."""
    left, right = shown.eyes[:, plane]
    if np.linalg.norm(right - left) < 0.5 * shown.baseline:
        return
    # behind what is near the eyes in the view from above, above it in the view from behind
    level = shown.nearby[:, plane[1]].min() - 0.3 * shown.size
    ends = np.array([[left[0], level], [right[0], level]])
    panel.annotate(
        "", page_point(ends[0]), page_point(ends[1]),
        arrowprops={"arrowstyle": "<|-|>", "color": GREY, "lw": 1.2, "shrinkA": 0, "shrinkB": 0},
    )  # fmt: skip
    for start, end in zip((left, right), ends, strict=True):
        panel.plot(*np.column_stack([start, end]), color=GREY, lw=0.7)
    middle = ends.mean(axis=0)
    panel.annotate(
        f"{shown.baseline:.1f} mm", page_point(middle), (0, 0), textcoords="offset points",
        ha="center", va="center", color=GREY, fontsize=11,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.5}, zorder=7,
    )  # fmt: skip


def _draw_images(panel: Axes, shown: _Geometry) -> None:
    """Both images' outlines with principal points and rings of equal angle through the lens."""
    start = 0.0
    for camera, name, colour in zip(shown.cameras, EYE_NAMES, _COLOURS, strict=True):
        size = np.array([camera.width, camera.height])
        # several sizes of images are drawn to one scale, the smaller ones in the middle
        corner = np.array([start, -0.5 * size[1]])
        outline = Rectangle(
            (corner[0], corner[1]), size[0], size[1], fill=False, edgecolor=colour, lw=1.6
        )
        panel.add_patch(outline)
        for angle in range(10, 90, 10):
            turn = np.linspace(0.0, 2.0 * np.pi, 181)
            ring = np.tan(np.radians(angle)) * np.column_stack([np.cos(turn), np.sin(turn)])
            pixels = camera.project(np.column_stack([ring, np.ones(len(turn))]))
            (line,) = panel.plot(*(pixels + 0.5 + corner).T, color=colour, lw=0.8, alpha=0.7)
            line.set_clip_path(outline)
            _write_angle(panel, pixels, angle, corner, size, colour)
        centre = corner + np.array(camera.principal_px) + 0.5
        panel.plot(*centre, "+", color=BLACK, ms=13, mew=1.5)
        panel.text(
            start + 0.5 * size[0], corner[1] + 1.03 * size[1], f"{name}: {size[0]} x {size[1]} px",
            color=colour, ha="center", va="top",
        )  # fmt: skip
        start += 1.08 * size[0]
    heights = max(camera.height for camera in shown.cameras)
    panel.set(
        xlim=(-0.04 * start, start),
        ylim=(0.66 * heights, -0.55 * heights),
        aspect="equal",
        title="images: principal point, angles from the optical axis (deg)",
    )
    panel.set_axis_off()


def _write_angle(
    panel: Axes, pixels: FloatArray, angle: int, corner: FloatArray, size: Any, colour: str
) -> None:
    """A ring's angle, where it crosses the image's middle row on the right."""
    margin = 0.04 * size
    u, v = pixels[0]
    if margin[0] < u < size[0] - margin[0] and margin[1] < v < size[1] - margin[1]:
        panel.text(
            u + corner[0], v + corner[1], str(angle), fontsize=8, color=colour, ha="center",
            va="center", bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6},
        )  # fmt: skip


def _write_joints(panel: Axes, summary: HeadSummary) -> None:
    """The numbers in the views, with names and ranges."""
    panel.set_axis_off()
    lines = []
    for number, joint in enumerate(summary.joints, start=1):
        lines.append(
            f"{number}  {joint.name} ({joint.moves}), {joint.lower_deg:.0f} to "
            f"{joint.upper_deg:.0f} deg"
        )
    if not lines:
        lines = ["no joints: the eyes do not move"]
    for eye in summary.eyes:
        lines.append(
            f"{eye.name} camera: {eye.lens}, {eye.horizontal_deg:.1f} x {eye.vertical_deg:.1f} deg"
            + (", without rays in a part of the image" if eye.folds else "")
        )
    lines += [
        "dashed: optical axes; shaded: fields of view; black: N",
        "green: joint axes (dot in a ring: towards you, cross: away)" if summary.joints else "",
    ]
    step = min(0.1, 1.0 / len(lines))
    for place, line in enumerate(lines):
        panel.text(0.0, 0.98 - step * place, line, transform=panel.transAxes, fontsize=11, va="top")
