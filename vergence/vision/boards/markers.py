"""Check a ChArUco board's image: squares that alternate at its corners, markers as printed."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.vision.targets import CharucoBoard

_PROBE_MARGINS: Final = 0.45
"""Distance of grey samples from a corner along both axes, in margins of a marker (chosen)."""
_LEAST_CONTRAST_GREY: Final = 5.0
"""Least contrast at a corner, grey levels (chosen: above noise)."""
_LEAST_RELATIVE_CONTRAST: Final = 0.25
"""Least contrast at a corner, as a fraction of the median of all corners (chosen)."""
_LEAST_CORRELATION: Final = 0.4
"""Least correlation of a marker's grey levels with its print (chosen)."""

BoardProjection = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Function from positions on the board, (n, 2) m, to pixels, (n, 2)."""


def upper_left_is_dark(board: CharucoBoard) -> bool:
    """True if the board's upper left square is black."""
    return not (board.legacy and board.rows % 2 == 0)


def mask_alternating_corners(
    image: NDArray[np.uint8],
    board: CharucoBoard,
    corner_indices: NDArray[np.intp],
    project: BoardProjection,
) -> NDArray[np.bool_]:
    """Check that black and white alternate around each corner as printed.

    Args:
        image: grey levels, shape (height, width).
        board: the board.
        corner_indices: (n,) indices of the corners.
        project: projection of the board into the image.

    Returns:
        (n,) mask of the corners that pass.
    """
    away = _PROBE_MARGINS * 0.5 * (board.square_m - board.marker_m)
    steps = away * np.array([[-1.0, -1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, 1.0]])
    probes = (board.corners_m[corner_indices][:, None] + steps).reshape(-1, 2)
    grey = grey_at_pixels(image, project(probes)).reshape(-1, 4)
    row, column = np.divmod(corner_indices, board.columns - 1)
    sign = np.where(((row + column) % 2 == 0) == upper_left_is_dark(board), 1.0, -1.0)
    contrast = 0.5 * sign * (grey[:, 2] + grey[:, 3] - grey[:, 0] - grey[:, 1])
    return contrast > max(
        _LEAST_CONTRAST_GREY, _LEAST_RELATIVE_CONTRAST * float(np.median(contrast))
    )


def fraction_of_markers_confirmed(
    image: NDArray[np.uint8],
    board: CharucoBoard,
    corner_indices: NDArray[np.intp],
    project: BoardProjection,
) -> float:
    """Fraction of the markers beside some corners whose image agrees with their print.

    Args:
        image: see `mask_alternating_corners`.
        board: see `mask_alternating_corners`.
        corner_indices: see `mask_alternating_corners`.
        project: see `mask_alternating_corners`.
    """
    row, column = np.divmod(corner_indices, board.columns - 1)
    beside = np.zeros((board.rows, board.columns), bool)
    for down in range(2):
        for right in range(2):
            beside[row + down, column + right] = True
    middles_m, printed = _squares(board)
    rows, columns = np.indices(beside.shape)
    marked = ((rows + columns) % 2 == 1) == upper_left_is_dark(board)
    chosen = (beside & marked).ravel()
    places = middles_m[chosen]
    grey = grey_at_pixels(image, project(places.reshape(-1, 2))).reshape(places.shape[:2])
    grey = grey - grey.mean(axis=1, keepdims=True)
    wanted = printed[chosen]
    scale = np.sqrt((grey**2).sum(axis=1) * (wanted**2).sum(axis=1))
    alike = (grey * wanted).sum(axis=1) / np.maximum(scale, 1e-6)
    return float((alike > _LEAST_CORRELATION).mean())


@lru_cache(maxsize=8)
def _squares(board: CharucoBoard) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centres of all cells by square, (squares, n, 2) m; their print minus its mean per square."""
    rows, columns = board.rows, board.columns
    size = len(board.cells) // rows
    x, y = (np.arange(size * count) + 0.5 for count in (columns, rows))
    middles = np.stack(np.meshgrid(x, y), axis=-1) - board.origin_cells
    by_square = (rows, size, columns, size)
    places_m = board.cell_m * middles.reshape(*by_square, 2).swapaxes(1, 2)
    cells = board.cells.astype(float).reshape(by_square).swapaxes(1, 2)
    printed = np.reshape(cells, (rows * columns, -1))
    return (
        np.reshape(places_m, (rows * columns, -1, 2)),
        printed - printed.mean(axis=1, keepdims=True),
    )


def grey_at_pixels(image: NDArray[np.uint8], pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Grey levels at pixels (n, 2); replicated beyond the border, the upper left pixel for nan."""
    remap: Any = cv2.remap
    where = np.nan_to_num(pixels, nan=-1e4)
    out = np.empty(len(where))
    for start in range(0, len(where), 16384):  # remap takes at most 32767 in a row
        part = where[None, start : start + 16384].astype(np.float32)
        out[start : start + part.shape[1]] = remap(
            image, part, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )[0]
    return out
