"""Marks beside a head as triangles: its optical axes, the fix by gaze, the target's board."""

from typing import Final

import numpy as np

from vergence.models.parts import FloatArray
from vergence.viewer.rasteriser import Triangles
from vergence.viewer.shapes import revolve
from vergence.vision.targets import PlanarTarget, outline_m

# grey levels of a board's cells and back, 0 to 255 (chosen: printed paper)
_BLACK: Final = 38.0
_WHITE: Final = 252.0
_BACK: Final = 190.0

_BALL_RINGS: Final = 12
"""Rings of a ball (chosen: round at its size)."""
_BACK_M: Final = 1e-3
"""Thickness of a board, m (chosen: as thin as card)."""


def rod(
    pose: FloatArray, length_m: float, radius_m: float, colour: tuple[int, int, int]
) -> Triangles:
    """A rod of even brightness.

    Args:
        pose: (4, 4) pose of its begin; it extends along z.
        length_m: m.
        radius_m: m.
        colour: RGB, 0 to 255.
    """
    return _turned(np.array([[radius_m, 0.0], [radius_m, length_m]]), pose, colour)


def ball(centre: FloatArray, radius_m: float, colour: tuple[int, int, int]) -> Triangles:
    """A ball of even brightness.

    Args:
        centre: (3,) m.
        radius_m: m.
        colour: RGB, 0 to 255.
    """
    pose = np.eye(4)
    pose[:3, 3] = centre
    angles = np.linspace(-0.5 * np.pi, 0.5 * np.pi, _BALL_RINGS)
    return _turned(radius_m * np.column_stack([np.cos(angles), np.sin(angles)]), pose, colour)


def board(target: PlanarTarget, pose: FloatArray) -> Triangles:
    """A board with its pattern on the front, plain on the back.

    Args:
        target: the pattern.
        pose: (4, 4) pose of its frame T.
    """
    cells = target.cells
    y, x = np.mgrid[: cells.shape[0], : cells.shape[1]].reshape(2, -1)
    square = np.array([[0, 0], [0, 1], [1, 1], [1, 0]])  # counterclockwise for the viewer
    corners = np.stack([x, y], axis=-1)[:, None] + square
    front = target.cell_m * (corners - target.origin_cells)
    back = outline_m(target)[None]
    squares = np.concatenate([
        np.pad(front, ((0, 0), (0, 0), (0, 1))),
        np.pad(back, ((0, 0), (0, 0), (0, 1)), constant_values=_BACK_M),
    ])  # fmt: skip
    greys = np.append(np.where(cells.ravel() > 0, _WHITE, _BLACK), _BACK)
    halves = squares[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 3)
    placed = halves @ pose[:3, :3].T + pose[:3, 3]
    colours = np.repeat(np.tile(greys[:, None], 3), 2, axis=0)
    return Triangles(placed, np.ones((len(placed), 3)), colours)


def _turned(profile: FloatArray, pose: FloatArray, colour: tuple[int, int, int]) -> Triangles:
    """The surface that a profile, radii and heights (k, 2), sweeps around a pose's z axis."""
    vertices, faces = revolve(profile)
    corners = (vertices @ pose[:3, :3].T + pose[:3, 3])[faces]
    return Triangles(
        corners, np.ones((len(faces), 3)), np.tile(np.array(colour, dtype=float), (len(faces), 1))
    )
