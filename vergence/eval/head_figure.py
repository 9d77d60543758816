"""Figure for checking a head by eye: its eyes, axes, fields of view and images."""

from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle

from vergence.eval.head_summary import HeadSummary, edge_rays, summarise_head
from vergence.files import atomic_file
from vergence.models.camera import Camera
from vergence.models.head import HeadModel
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.models.posture import rest_poses
from vergence.reporting.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    Labels,
    as_float_pair,
    figure_style,
    new_figure,
)

_COLOURS: Final = (BLUE, ORANGE)
_VIEWS: Final = (
    ("from above", 0, 2, "x (mm)", "z (mm), forward"),
    ("from the right", 2, 1, "z (mm), forward", "y (mm), down"),
    ("from behind", 0, 1, "x (mm)", "y (mm), down"),
)
"""Title, axes of N across and up the page, and their labels; y points down the page."""
_MM: Final = 1000.0
"""Millimetres per metre (physical: conversion of units)."""
_MAX_BASE_SPANS: Final = 2.0
"""Distance of the base from N, in distances of the farthest joint or eye, from which it is told in
words: drawn, it would shrink the head (chosen)."""
_OUTLINE_RAYS: Final = 49
"""Rays across a field of view (chosen: smoothness of its outline)."""
_AXIS_MERGE_TOLERANCE: Final = 0.02
"""Largest distance, as a fraction of the head's size, and difference of unit directions at which
axes are drawn as one (chosen)."""
_RING_STEPS: Final = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
"""Candidate spacings of the rings of equal angle, degrees (chosen: round numbers)."""
_MOST_RINGS: Final = 4.5
"""Most rings between the principal point and the farther edge (chosen: room for their labels)."""


class _Geometry:
    """Geometry of the three views: positions in N at rest, millimetres.

    Args:
        head: one head.
    """

    def __init__(self, head: HeadModel) -> None:
        posture = rest_poses(head)
        from_base = np.linalg.inv(posture.frame_n)
        poses = head.camera_poses(head.rest())
        self.eyes = _MM * poses[:, :3, 3]
        self.turns = poses[:, :3, :3]
        self.cameras = [Camera.of(head, eye) for eye in range(2)]
        self.fields = [_field(camera) for camera in self.cameras]
        self.base = np.asarray(_MM * from_base[:3, 3], np.float64)
        bodies, placed = head.links.bodies(), from_base @ posture.links
        self.axes = [(_MM * pose[:3, 3], pose[:3, 2]) for pose in placed]
        self.has_neck = any(head.joints[:3])
        points = [*self.eyes, np.zeros(3), *(origin for origin, _ in self.axes)]
        span = float(np.linalg.norm(points, axis=1).max())
        self.base_is_near = bool(np.linalg.norm(self.base) < _MAX_BASE_SPANS * span)
        if self.has_neck and self.base_is_near:
            points.append(self.base)
        low, high = np.min(points, axis=0), np.max(points, axis=0)
        self.baseline = float(np.linalg.norm(self.eyes[1] - self.eyes[0]))
        eye_axes = [a for a, body in zip(self.axes, bodies, strict=True) if body.joints[0] >= 3]
        self.nearby = np.array([*self.eyes, np.zeros(3), *(origin for origin, _ in eye_axes)])
        self.size = max(self.baseline, 0.8 * float((high - low).max()))
        self.low, self.high = low - 0.45 * self.size, high + 0.45 * self.size
        self.high[2] += 0.35 * self.size  # ahead, where the eyes look


def _field(camera: Camera) -> FloatArray:
    """(2, n, 3) unit rays in the camera frame, along the row and column of its principal point.

    They are evenly spaced in angle, so that a field of view of 180 degrees has an area too.
    """
    (u, v), (right, bottom) = camera.principal.tolist(), (camera.width - 0.5, camera.height - 0.5)
    edges, _ = edge_rays(camera, np.array([[-0.5, v], [right, v], [u, -0.5], [u, bottom]]))
    angles = np.arctan(edges)
    rays = np.zeros((2, _OUTLINE_RAYS, 3))
    for axis in range(2):
        swept = np.linspace(angles[2 * axis, axis], angles[2 * axis + 1, axis], _OUTLINE_RAYS)
        rays[axis, :, axis], rays[axis, :, 2] = np.sin(swept), np.cos(swept)
    return rays


def draw_head(head: HeadModel, path: Path, summary: HeadSummary | None = None) -> None:
    """Draw a head into a PNG file, to be checked by eye.

    Args:
        head: one head, not a population.
        path: the file, replaced if it exists; its folder must exist.
        summary: summary of the head; computed by default.

    Raises:
        OSError: the file cannot be written.
    """
    with figure_style():
        figure = compose_head(head, summary or summarise_head(head))
        with atomic_file(path) as partial:
            figure.savefig(partial, format="png", dpi=110, metadata={"Software": None})


def compose_head(head: HeadModel, summary: HeadSummary) -> Figure:
    """Compose the figure of a head.

    Args:
        head: one head, not a population.
        summary: summary of the head.
    """
    shown = _Geometry(head)
    with figure_style():
        figure = new_figure(13.0, 10.4)
        grid = figure.add_gridspec(2, 2, wspace=0.06, hspace=0.06)
        views: list[tuple[Axes, Labels]] = []
        for place, (title, across, up, xlabel, ylabel) in zip(
            ((0, 0), (0, 1), (1, 0)), _VIEWS, strict=True
        ):
            panel = figure.add_subplot(grid[place])
            views.append((panel, _draw_view(panel, shown, across, up)))
            panel.set(title=title, xlabel=xlabel, ylabel=ylabel)
        right = grid[1, 1].subgridspec(2, 2, height_ratios=(1.0, 1.05))
        for eye in range(2):
            draw_field_of_view(
                figure.add_subplot(right[0, eye]), shown.cameras[eye], eye, _COLOURS[eye]
            )
        _write_joints(figure.add_subplot(right[1, :]), summary, shown)
        figure.suptitle(
            f"{head.name}: baseline {summary.baseline_mm:.1f} mm, at rest, in frame N", fontsize=14
        )
        for _ in range(2):  # the second layout makes room for the numbers of wider limits
            figure.draw_without_rendering()
            for panel, _labels in views:
                _make_equal(panel)
        figure.set_layout_engine("none")
        for _panel, labels in views:
            labels.place()
    return figure


def _draw_view(panel: Axes, shown: _Geometry, across: int, up: int) -> Labels:
    """Draw the view along an axis of N; the caller places the labels after the layout."""
    plane = [across, up]
    length = 0.3 * shown.size
    labels = Labels(panel)
    _draw_baseline(panel, shown, plane, labels)
    towards = 1.0 if across == 2 else -1.0  # direction to the reader along the view's axis
    far = 4.0 * float((shown.high - shown.low).max())
    apart = float(np.linalg.norm((shown.eyes[1] - shown.eyes[0])[plane]))
    seen_as_one = apart < _AXIS_MERGE_TOLERANCE * shown.size
    for eye, (origin, turn) in enumerate(zip(shown.eyes, shown.turns, strict=True)):
        colour, start = _COLOURS[eye], origin[plane]
        if {across, up} != {0, 1}:
            # the image axis that this view shows; it differs for a camera that is rolled
            side = int(np.argmax(np.linalg.norm(turn[plane, :2], axis=0)))
            rays = shown.fields[eye][side] @ turn.T
            ends = start + far * rays[:, plane]
            panel.add_patch(
                Polygon([start, *ends], closed=True, facecolor=colour, alpha=0.10, linewidth=0.0)
            )
            for end in (ends[0], ends[-1]):
                panel.plot(*np.column_stack([start, end]), color=colour, lw=0.8, alpha=0.6)
                along = (end - start) * (shown.size / far)
                labels.avoid_line(start + 0.4 * along, start + along)
        direction = turn[plane, 2]
        if np.linalg.norm(direction) > 0.1:
            end = start + far * direction
            panel.plot(*np.column_stack([start, end]), color=colour, lw=1.6, ls=(0, (6, 3)))
            labels.avoid_line(start, end)
        panel.plot(*start, "s", color=colour, ms=8, zorder=6)
        labels.avoid(start, 5.0)
        outside = -1.0 if eye == 0 else 1.0
        # labels stand behind the eye, away from its line of sight
        back = (
            (outside, -1.0) if up == 2 else (-1.0, 0.3 * outside) if across == 2 else (outside, 0.0)
        )
        if not seen_as_one:
            labels.add(start, EYE_NAMES[eye], colour, back)
        elif eye == 1:
            labels.add(start, "both eyes", BLACK, (-1.0, -0.5))
    _draw_frame(panel, np.zeros(3), length, plane, labels)
    for numbers, origin, axis in _seen_as_one(shown, across, up):
        ahead = towards * axis[3 - across - up]
        _draw_axis(panel, origin[plane], axis[plane], ahead, 0.5 * length, numbers, labels)
    if shown.has_neck and shown.base_is_near:
        panel.plot(*shown.base[plane], "^", color=GREY, ms=9, zorder=5)
        labels.avoid(shown.base[plane], 6.0)
        labels.add(shown.base[plane], "base", GREY, (1.0, 0.0))
    low, high = shown.low[plane], shown.high[plane]
    panel.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]) if up == 1 else (low[1], high[1]))
    return labels


def _make_equal(panel: Axes) -> None:
    """Give both axes of a panel the same scale by widening the limits of one, after layout."""
    box = panel.bbox
    ends = np.array([panel.get_xlim(), panel.get_ylim()])
    spans = np.abs(ends[:, 1] - ends[:, 0])
    scale = float((spans / [box.width, box.height]).max())
    wider = (
        ends.mean(axis=1)[:, None]
        + (ends - ends.mean(axis=1)[:, None])
        * (scale * np.array([box.width, box.height]) / spans)[:, None]
    )
    panel.set(xlim=tuple(wider[0]), ylim=tuple(wider[1]))


def _seen_as_one(
    shown: _Geometry, across: int, up: int
) -> list[tuple[str, FloatArray, FloatArray]]:
    """Joint axes with their numbers; axes that coincide in a view are merged."""
    found: list[tuple[str, FloatArray, FloatArray]] = []
    plane = [across, up]
    for number, (origin, axis) in enumerate(shown.axes, start=1):
        for place, (numbers, other, direction) in enumerate(found):
            apart = np.linalg.norm((origin - other)[plane]) / shown.size
            if (
                apart < _AXIS_MERGE_TOLERANCE
                and np.linalg.norm(axis - direction) < _AXIS_MERGE_TOLERANCE
            ):
                found[place] = (f"{numbers}, {number}", other, direction)
                break
        else:
            found.append((str(number), origin, axis))
    return found


def _draw_frame(
    panel: Axes, origin: FloatArray, length: float, plane: list[int], labels: Labels
) -> None:
    """Draw the axes of N that lie in the plane of a view."""
    start = origin[plane]
    for axis, name in enumerate("xyz"):
        tip = origin.copy()
        tip[axis] += length
        if axis in plane:
            panel.annotate(
                "", as_float_pair(tip[plane]), as_float_pair(start),
                arrowprops={"arrowstyle": "-|>", "color": BLACK, "lw": 1.4, "shrinkA": 0,
                            "shrinkB": 0},
            )  # fmt: skip
            labels.add(tip[plane], name, BLACK, as_float_pair((tip - origin)[plane]))
            labels.avoid_line(start, tip[plane])
    labels.add(start, "N", BLACK, (-1.0, -1.0))
    labels.avoid(start)


def _draw_axis(
    panel: Axes, start: FloatArray, direction: FloatArray, towards: float, half: float,
    text: str, labels: Labels,
) -> None:  # fmt: skip
    """Draw a joint's axis as an arrow; along the view as a ring with a dot (towards) or cross."""
    if np.linalg.norm(direction) < 0.2:
        panel.plot(*start, "o", color=GREEN, ms=13, mfc="none", mew=1.6, zorder=5)
        panel.plot(*start, "o" if towards > 0.0 else "x", color=GREEN, ms=4 if towards > 0 else 8)
        labels.avoid(start, 7.0)
        labels.add(start, text, GREEN, (0.7, 0.7))
        return
    ends = np.array([start - half * direction, start + half * direction])
    panel.plot(*ends.T, color=GREEN, lw=2.0, zorder=4)
    panel.plot(*start, "o", color=GREEN, ms=5, zorder=5)
    panel.annotate(
        "", as_float_pair(ends[1]), as_float_pair(start),
        arrowprops={"arrowstyle": "-|>", "color": GREEN, "lw": 1.6, "shrinkA": 0, "shrinkB": 0},
    )  # fmt: skip
    labels.avoid_line(*ends)
    labels.add(ends[1], text, GREEN, as_float_pair(direction))


def _draw_baseline(panel: Axes, shown: _Geometry, plane: list[int], labels: Labels) -> None:
    """Draw the baseline as a dimension line next to the eyes."""
    left, right = shown.eyes[:, plane]
    if np.linalg.norm(right - left) < 0.5 * shown.baseline:
        return
    # behind the parts near the eyes in the view from above, above them in the view from behind
    level = shown.nearby[:, plane[1]].min() - 0.3 * shown.size
    ends = np.array([[left[0], level], [right[0], level]])
    panel.annotate(
        "", as_float_pair(ends[0]), as_float_pair(ends[1]),
        arrowprops={"arrowstyle": "<|-|>", "color": GREY, "lw": 1.2, "shrinkA": 0, "shrinkB": 0},
    )  # fmt: skip
    for start, end in zip((left, right), ends, strict=True):
        panel.plot(*np.column_stack([start, end]), color=GREY, lw=0.7)
        labels.avoid_line(start, end)
    labels.avoid_line(*ends)
    behind = (0.0, -1.0)  # down in the view from above, up in the view from behind
    white = {"facecolor": "white", "edgecolor": "none", "pad": 0.5}
    labels.add(ends.mean(axis=0), f"{shown.baseline:.1f} mm", GREY, behind, bbox=white)


def _write_joints(panel: Axes, summary: HeadSummary, shown: _Geometry) -> None:
    """Write the legend of the joints' numbers, with names and ranges, and of the cameras."""
    panel.set_axis_off()
    lines = []
    for number, joint in enumerate(summary.joints, start=1):
        lines.append(
            f"{number}  {joint.name} ({joint.moves}), {joint.lower_deg:.0f} to "
            f"{joint.upper_deg:.0f} deg"
        )
    if shown.has_neck and not shown.base_is_near:
        x, y, z = shown.base
        lines.append(f"base at x = {x:z.0f}, y = {y:z.0f}, z = {z:z.0f} mm, not drawn")
    if not lines:
        lines = ["no joints: the eyes do not move"]
    for eye in summary.eyes:
        lines.append(
            f"{eye.name} camera: {eye.lens}, {eye.horizontal_deg:.1f} x {eye.vertical_deg:.1f} deg"
            + (", without rays in a part of the image" if eye.folds else "")
        )
    lines += [
        "dashed: optical axes; shaded: fields of view; black: N",
        "images: + principal point, rings of equal angle from the optical axis",
        "green: joint axes (dot in a ring: towards you, cross: away)" if summary.joints else "",
    ]
    step = min(0.1, 1.0 / len(lines))
    for place, line in enumerate(lines):
        panel.text(0.0, 0.98 - step * place, line, transform=panel.transAxes, fontsize=11, va="top")


def draw_field_of_view(panel: Axes, camera: Camera, eye: int, colour: str) -> None:
    """Draw an image's outline with its principal point and rings of equal angle through the lens.

    Args:
        panel: axes to draw on.
        camera: camera of the eye.
        eye: 0 for the left eye, 1 for the right eye.
        colour: colour of the eye.
    """
    width, height = camera.size
    u_0, v_0 = camera.principal.tolist()
    outline = Rectangle(
        (-0.5, -0.5), width, height, fill=False, edgecolor=colour, lw=1.6, clip_on=False
    )
    panel.add_patch(outline)
    panel.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal")
    panel.set_axis_off()
    panel.set_title(f"{EYE_NAMES[eye]}: {width} x {height} px", color=colour, fontsize=11)
    edges = np.array([[-0.5, v_0], [width - 0.5, v_0]])
    widest = float(np.degrees(np.arctan(np.abs(edge_rays(camera, edges)[0][:, 0]))).max())
    step = next((s for s in _RING_STEPS if widest / s <= _MOST_RINGS), _RING_STEPS[-1])
    for angle in np.arange(step, 90.0, step):
        turn = np.linspace(0.0, 2.0 * np.pi, 181)
        ring = np.tan(np.radians(angle)) * np.column_stack([np.cos(turn), np.sin(turn)])
        pixels = camera.project(np.column_stack([ring, np.ones(len(turn))]))
        (line,) = panel.plot(*pixels.T, color=colour, lw=0.8, alpha=0.7)
        line.set_clip_path(outline)
        # label on the side of the image that shows more of the ring
        side = pixels[0 if u_0 <= 0.5 * width else 90]
        margin = 0.05 * np.array([width, height])
        if ((side > margin) & (side < np.array([width, height]) - margin)).all():
            panel.text(
                side[0], side[1], f"{angle:g}°", fontsize=9, color=colour, ha="center",
                va="center", bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6},
            )  # fmt: skip
    panel.plot(u_0, v_0, "+", color=BLACK, ms=13, mew=1.5)
