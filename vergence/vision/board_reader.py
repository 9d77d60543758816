"""Reading a board: whether what an image shows is the board that was printed, and sharp."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.models.boards import PlanarTarget

_LEAST_CONTRAST_GREY = 20.0
_LEAST_CELL_CONTRAST = 0.2
"""How far every cell must lie from the middle grey, as a share of the board's contrast."""
_PROBE_CELLS = 0.35
_PROBE_PX = 1.8
_LEAST_EDGE_CONTRAST = 0.66
"""Contrast of the probes to both sides of the edges, as a share of the board's. A step smeared
over s has 2 d / s of it at a distance of d to each side: 1.8 px see a smear of 5.5 px."""


class BoardReader:
    """Compares an image with a board's print through a homography."""

    def __init__(self, target: PlanarTarget) -> None:
        """Prepare where cells and edges lie."""
        white = (target.cells > 0).astype(int)
        rows, columns = white.shape
        y, x = np.mgrid[:rows, :columns] + 0.5
        self._centres = np.stack([x.ravel(), y.ravel()], axis=-1)
        self._sign = np.where(white.ravel() > 0, 1.0, -1.0)
        middles, normals = [], []
        for axis, along in ((1, np.array([1.0, 0.0])), (0, np.array([0.0, 1.0]))):
            step = np.diff(white, axis=axis)
            y, x = np.nonzero(step)
            middles.append(np.stack([x, y], axis=-1) + 0.5 + 0.5 * along)
            normals.append(step[y, x, None] * along)
        edges, across = np.concatenate(middles), np.concatenate(normals)
        # where the grey is taken: the cells' centres, and to both sides of the edges
        self._points = np.concatenate([self._centres, edges, edges])[None]
        self._sides = np.concatenate([np.zeros_like(self._centres), across, -across])[None]
        self._edges = len(edges)
        self._means = self._averages(white.ravel(), len(middles[0]))

    def _averages(self, white: NDArray[np.int_], across_x: int) -> NDArray[np.float64]:
        """Rows that take the grey at cells, at edges' white side and at their black side.

        They give the mean of white cells, of black cells, and the mean step across the edges
        that a line along x crosses, and across the others.
        """
        cells, edges = len(white), self._edges
        rows = np.zeros((4, cells + 2 * edges))
        rows[0, :cells] = white / white.sum()
        rows[1, :cells] = (1 - white) / (1 - white).sum()
        for row, kind in ((2, slice(0, across_x)), (3, slice(across_x, edges))):
            share = np.zeros(edges)
            share[kind] = 1.0 / len(share[kind])
            rows[row, cells:] = np.concatenate([share, -share])
        return rows

    def reads(
        self, image: NDArray[np.uint8], pixel_from_cell: NDArray[np.float64], cell_px: float
    ) -> bool:
        """Whether every cell has the grey that is printed there and the edges are sharp.

        Args:
            image: grey levels, shape (height, width).
            pixel_from_cell: homography to pixels from cells of the board, shape (3, 3).
            cell_px: length of a cell in the image.

        Returns:
            False for another board, one that is partly hidden, and one that is smeared by more
            than about a cell or 5.5 pixels, whichever is less.
        """
        points = self._points + min(_PROBE_CELLS, _PROBE_PX / cell_px) * self._sides
        where: Any = cv2.perspectiveTransform(points, pixel_from_cell).astype(np.float32)
        remap: Any = cv2.remap
        grey = remap(image, where, None, cv2.INTER_LINEAR)[0].astype(float)
        light, dark, step_x, step_y = (self._means @ grey).tolist()
        contrast = light - dark
        if contrast < _LEAST_CONTRAST_GREY:
            return False
        if min(step_x, step_y) < _LEAST_EDGE_CONTRAST * contrast:
            return False
        cells = (grey[: len(self._sign)] - 0.5 * (light + dark)) * self._sign
        return bool(cells.min() > _LEAST_CELL_CONTRAST * contrast)
