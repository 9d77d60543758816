"""Figure of an eye's image: its size, principal point, and angles of view."""

from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from vergence.eval.head_summary import edge_rays
from vergence.models.camera import Camera
from vergence.models.parts import EYE_NAMES
from vergence.reporting.style import BLACK

_RING_STEPS: Final = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
"""Candidate spacings of the rings of equal angle, degrees (chosen: round numbers)."""
_MOST_RINGS: Final = 4.5
"""Most rings between the principal point and the farther edge (chosen: room for their labels)."""


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
