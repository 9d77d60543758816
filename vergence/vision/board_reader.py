"""Reading a board: whether what an image shows is the board that was printed, and sharp."""

from collections.abc import Sequence
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.models.boards import PlanarTarget
from vergence.vision.optics import EyeCamera

_LEAST_CONTRAST_GREY = 20.0
_LEAST_CELL_CONTRAST = 0.2
"""How far every cell must lie from the middle grey, as a share of the board's contrast."""
_PROBE_CELLS = 0.35
_PROBE_PX = 1.8
_LEAST_EDGE_CONTRAST = 0.66
"""Contrast of the probes to both sides of the edges, as a share of the board's. A step smeared
over s has 2 d / s of it at a distance of d to each side: 1.8 px see a smear of 5.5 px."""


NO_SHIFT: Final = np.zeros(2, np.int_)


class BoardReader:
    """Compares an image with a board's print through a homography.

    The homography leads to pixels, or to rays where the lens bends boards.

    Args:
        target: the board.
        outer: its four outermost corners, which give the homography.
        camera: the eye's intrinsics, or None for a pinhole.
    """

    def __init__(
        self, target: PlanarTarget, outer: Sequence[int], camera: EyeCamera | None
    ) -> None:
        """Prepare where cells and edges lie."""
        self._camera = camera if camera is not None and camera.bends_boards else None
        self._outer = list(outer)
        corners = target.corners_m / target.cell_m + target.origin_cells
        self._outer_cells = np.asarray(corners[self._outer], np.float32)
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
        self,
        image: NDArray[np.uint8],
        corners: NDArray[np.float64],
        cell_px: float,
        shift: NDArray[np.int_] = NO_SHIFT,
    ) -> bool:
        """Whether every cell has the grey that is printed there and the edges are sharp.

        Args:
            image: grey levels, shape (height, width), or a part of them.
            corners: the board's in that part, px, shape (n, 2).
            cell_px: length of a cell in the image.
            shift: of the part's upper left pixel in the whole image, shape (2,).

        Returns:
            False for another board, one that is partly hidden, and one that is smeared by more
            than about a cell or 5.5 pixels, whichever is less.
        """
        points = self._points + min(_PROBE_CELLS, _PROBE_PX / cell_px) * self._sides
        where = self._places(points, corners[self._outer], shift)
        if where is None:
            return False
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

    def _places(
        self, points: NDArray[np.float64], outer: NDArray[np.float64], shift: NDArray[np.int_]
    ) -> Any:
        """Pixels (1, n, 2) of points of the board in cells, by its outermost corners.

        None where the lens has no rays for the corners.
        """
        if self._camera is None:
            pixel_from_cell = cv2.getPerspectiveTransform(
                self._outer_cells, outer.astype(np.float32)
            )
            return cv2.perspectiveTransform(points, pixel_from_cell).astype(np.float32)
        corner_rays = self._camera.rays(outer + shift).astype(np.float32)
        if not np.isfinite(corner_rays).all():
            return None
        ray_from_cell = cv2.getPerspectiveTransform(self._outer_cells, corner_rays)
        rays = cv2.perspectiveTransform(points, ray_from_cell)[0]
        pixels = self._camera.project(np.column_stack([rays, np.ones(len(rays))])) - shift
        return pixels[None].astype(np.float32)
