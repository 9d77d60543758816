"""Read the tags of an AprilGrid, and select those that are arranged as on the board."""

import threading
from typing import Any, Final

import cv2
import numpy as np
import pyapriltags
from numpy.typing import NDArray

from vergence.vision.tag_families import (
    CORRECTED_BITS,
    GRID_BORDER_BITS,
    GRID_FAMILY,
    AprilGrid,
    library_family,
)
from vergence.vision.tags.library import FoundSquare

SEARCH_SCALES: Final = (0.5, 1.0, 1.0, 2.0)
"""Image scale of each search method, quick ones first; the third reads bits of 2.5 px (chosen:
small tags against time)."""
_DILATIONS: Final = {
    0: cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3)),
    2: np.ones((2, 2), np.uint8),
}
"""Kernel that dilates white, by search method; the first for all others."""
_DILATION_SHIFT_PX: Final = (1.0, 1.0, 0.5, 1.0)
"""Inward move of a tag's edges by that dilation, by search method, px (numerical)."""
_MAX_ENLARGED_PIXELS: Final = 2_000_000
"""Largest image that is enlarged, pixels (chosen: search time)."""
_LEAST_SIDE_PX: Final = 24
"""Smallest side of a scaled image that is searched, px (chosen)."""
_MAX_NEIGHBOUR_ERROR: Final = 0.35
"""Largest distance of a tag from its neighbour's prediction, in tag edges per row or column between
them (chosen: allows for lens distortion)."""
_MAX_NEIGHBOUR_STEPS: Final = 2
"""Most rows and columns between a tag and one that it predicts (chosen)."""


class _Detectors(threading.local):
    """The library's detector of this thread; it is not thread-safe."""

    def __init__(self) -> None:
        self.made: Any = None


_DETECTORS: Final = _Detectors()


def find_grid_tags(image: NDArray[np.uint8], method_index: int) -> list[FoundSquare]:
    """Find tags with a border of two bits in an image.

    The squares at the corners of tags connect all black to one region; dilating white by a pixel
    separates them.

    Args:
        image: grey levels, shape (height, width).
        method_index: index of the search method in `SEARCH_SCALES`.

    Returns:
        Tags that the AprilTag library reads, with corners accurate to a pixel or two.
    """
    scale = SEARCH_SCALES[method_index]
    if min(image.shape) * scale < _LEAST_SIDE_PX or (
        scale > 1.0 and image.size > _MAX_ENLARGED_PIXELS
    ):
        return []
    method = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_CUBIC
    sized = image if scale == 1.0 else cv2.resize(image, None, None, scale, scale, method)
    wide = cv2.dilate(sized, _DILATIONS.get(method_index, _DILATIONS[0]))
    if _DETECTORS.made is None:
        _DETECTORS.made = _make()
    found = []
    for each in _DETECTORS.made.detect(np.ascontiguousarray(wide)):
        # the library has pixel edges at integers, and counts corners from the lower left
        corners = (
            _widened(np.asarray(each.corners, float)[::-1], _DILATION_SHIFT_PX[method_index])
            / scale
            - 0.5
        )
        found.append(FoundSquare(each.tag_id, each.hamming, corners))
    return found


def _widened(corners: NDArray[np.float64], by: float) -> NDArray[np.float64]:
    """Corners, (4, 2), of a quadrilateral with its edges moved outwards by a distance."""
    along = np.roll(corners, -1, axis=0) - corners
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    back = np.roll(along, 1, axis=0)
    sine = back[:, 0] * along[:, 1] - back[:, 1] * along[:, 0]
    return np.asarray(corners + by * (back - along) / np.maximum(np.abs(sine), 0.2)[:, None])


def _make() -> Any:
    """Make a detector of the library for the family with the wider border of AprilGrids."""
    detector: Any = pyapriltags.Detector(families="", nthreads=1, quad_decimate=1.0)
    family = library_family(detector.libc, GRID_FAMILY)
    code = family.contents
    wider = GRID_BORDER_BITS - 1
    code.width_at_border += 2 * wider
    code.total_width += 2 * wider
    for bit in range(int(code.nbits)):
        code.bit_x[bit] += wider
        code.bit_y[bit] += wider
    detector.libc.apriltag_detector_add_family_bits(
        detector.tag_detector_ptr, family, CORRECTED_BITS[GRID_FAMILY]
    )
    return detector


def largest_group_row_column(
    tags: list[FoundSquare], columns: int, gap_to_edge_ratio: float
) -> list[tuple[FoundSquare, int, int]]:
    """Select the largest connected group of tags that are arranged as on a board.

    Only neighbours are compared: lens distortion bends a whole board, but hardly moves neighbours
    relative to each other.

    Args:
        tags: tags, perhaps of several boards.
        columns: tags per row of the board; the number of rows is free.
        gap_to_edge_ratio: ratio of gap to tag edge, see `AprilGrid`.

    Returns:
        Tags with their rows, counted from below, and columns; no number occurs twice.
    """
    if not tags:
        return []
    row, column = np.divmod([each.id for each in tags], columns)
    corners = np.stack([each.corners for each in tags])
    edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).mean(axis=1)
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    near = (np.abs(row[:, None] - row) <= _MAX_NEIGHBOUR_STEPS) & (
        np.abs(column[:, None] - column) <= _MAX_NEIGHBOUR_STEPS
    )
    fits = np.zeros((len(tags), len(tags)), bool)
    for i in range(len(tags)):
        others = np.flatnonzero(near[i])
        transform = cv2.getPerspectiveTransform(square, corners[i].astype(np.float32))
        away = (1.0 + gap_to_edge_ratio) * np.stack(
            [column[others] - column[i], row[i] - row[others]], -1
        )
        predicted = cv2.perspectiveTransform(away[None] + 0.5, transform)[0]
        beside = np.linalg.norm(predicted - corners[others].mean(axis=1), axis=1)
        steps = np.maximum(np.abs(row[others] - row[i]), np.abs(column[others] - column[i]))
        fits[i, others] = beside < _MAX_NEIGHBOUR_ERROR * np.maximum(steps, 1) * edge[others]
    fits &= fits.T
    numbers = np.array([each.id for each in tags])
    fits &= (numbers[:, None] != numbers) | np.eye(len(tags), dtype=bool)
    best: list[int] = []
    left = set(range(len(tags)))
    while left:
        group: list[int] = []
        rim = [left.pop()]
        while rim:
            i = rim.pop()
            if numbers[i] not in numbers[group]:
                group.append(i)
            more = left.intersection(np.flatnonzero(fits[i]).tolist())
            left -= more
            rim.extend(more)
        best = max(best, group, key=len)
    return [(tags[i], int(row[i]), int(column[i])) for i in best]


def estimate_gap_ratio_and_edge_px(
    corners: NDArray[np.float64], target: AprilGrid
) -> tuple[float, float]:
    """Estimate the ratio of gap to tag edge in an image.

    Args:
        corners: corners of all tags, px, shape (tags, 4, 2); nan for unknown ones.
        target: the board.

    Returns:
        The median ratio and the mean edge, px; both nan if no two neighbours are known.
    """
    grid = np.full((target.rows, target.columns, 4, 2), np.nan)
    grid[tuple(target.tag_cells.T)] = corners
    gaps, edges = [], []
    for side, (a, b, c, d) in ((grid, (0, 1, 3, 2)), (grid.swapaxes(0, 1), (0, 3, 1, 2))):
        for start, end in ((a, b), (c, d)):
            edge = np.linalg.norm(side[:, :, end] - side[:, :, start], axis=-1)
            gap = np.linalg.norm(side[:, 1:, start] - side[:, :-1, end], axis=-1)
            mean = 0.5 * (edge[:, 1:] + edge[:, :-1])
            gaps.append((gap / mean).ravel())
            edges.append(mean.ravel())
    ratios, lengths = np.concatenate(gaps), np.concatenate(edges)
    there = np.isfinite(ratios)
    if not there.any():
        return np.nan, np.nan
    return float(np.median(ratios[there])), float(lengths[there].mean())
