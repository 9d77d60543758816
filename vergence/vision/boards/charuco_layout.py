"""Estimate the counts of a visible ChArUco board if the stated ones do not fit."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.errors import ConfigurationError
from vergence.vision.boards.charuco import marker_corners_m
from vergence.vision.targets import CharucoBoard

_MOST_COLUMNS: Final = 24
"""Largest number of columns that is tried (chosen: search time)."""
_MAX_ERROR_EDGES: Final = 0.25
"""Largest distance of a marker's corner from its place on a board, in edges of a marker (chosen:
allows for lens distortion)."""
_DRAWS: Final = 100
"""Draws of four corners for a board (chosen: search time; 60 % good ones need 22 for 95 %)."""
_LEAST_ARRANGED_FRACTION: Final = 0.6
"""Least fraction of the markers that must be arranged as on one board (chosen)."""


def alternative_charuco(
    corners: NDArray[np.float32],
    numbers: NDArray[np.intp],
    missed: CharucoBoard,
    dictionary: str,
) -> CharucoBoard | None:
    """Find the board on which most of some markers are arranged as in an image.

    Args:
        corners: (n, 4, 2) corners of the markers, px, see `find_markers`.
        numbers: (n,) their numbers.
        missed: the board that was not found; its sizes are kept, and if the columns agree, at
            least its rows.
        dictionary: OpenCV's name of the markers' dictionary.

    Returns:
        The board, with as many rows as the markers need; None if too few markers agree.
    """
    edge = float(np.median(np.linalg.norm(corners[:, 0] - corners[:, 1], axis=1)))
    best, most = None, _LEAST_ARRANGED_FRACTION * corners.size / 2
    for board in _boards(missed, int(numbers.max()), dictionary):
        places = marker_corners_m(board)[numbers].reshape(-1, 2)
        fitted: Any = cv2.findHomography(
            places, corners.reshape(-1, 2), cv2.RANSAC, _MAX_ERROR_EDGES * edge, maxIters=_DRAWS
        )
        if fitted[0] is not None and fitted[1].sum() > most:
            best, most = board, fitted[1].sum()
    return best


def _boards(missed: CharucoBoard, largest: int, dictionary: str) -> Iterator[CharucoBoard]:
    """Boards of any number of columns and both layouts that have the largest number."""
    for columns in dict.fromkeys([missed.columns, missed.rows, *range(3, _MOST_COLUMNS + 1)]):
        least = missed.rows if columns == missed.columns else 3
        rows = max(least, -(-2 * (largest + 1) // columns))
        for legacy in (False, True):
            even = rows + rows % 2 if legacy else rows
            try:
                yield replace(
                    missed, columns=columns, rows=even, legacy=legacy, dictionary=dictionary
                )
            except ConfigurationError:  # too many markers for the dictionary
                continue
