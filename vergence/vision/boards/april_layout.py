"""Estimate counts and spacing of a visible AprilGrid if the stated ones do not fit."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vergence.errors import ConfigurationError
from vergence.vision.boards.april_tags import (
    estimate_gap_ratio_and_edge_px,
    find_grid_tags,
    largest_group_row_column,
)
from vergence.vision.tag_families import AprilGrid
from vergence.vision.tags.library import FoundSquare

_SEARCH_METHODS: Final = (1, 3)
"""Search methods of `SEARCH_SCALES` that are tried (numerical: indices)."""
_MOST_COLUMNS: Final = 24
"""Largest number of columns that is tried (chosen: search time)."""
_LEAST_TAGS: Final = 3
"""Least number of tags of a board (chosen)."""
_LEAST_ARRANGED_FRACTION: Final = 0.6
"""Least fraction of the tags in the image that must be arranged as on one board (chosen)."""
_SPACING_STEP: Final = 0.01
"""Resolution of estimated spacings (chosen: spacings are round numbers)."""


def alternative_grids(
    image: NDArray[np.uint8], missed_grid: AprilGrid | None
) -> Iterator[AprilGrid]:
    """Find boards that explain the tags in an image.

    Args:
        image: grey levels, shape (height, width).
        missed_grid: the board that was not found; its tag edge is kept. None for any.

    Yields:
        Boards with the number of columns that most tags agree with, as many rows as the tags need,
        and the estimated spacing.
    """
    given = missed_grid is not None
    missed_grid = missed_grid or AprilGrid()
    for method_index in _SEARCH_METHODS:
        found = find_grid_tags(image, method_index)
        if len(found) < _LEAST_TAGS:
            continue
        spacing = _spacing(found, missed_grid)
        best: list[tuple[FoundSquare, int, int]] = []
        columns = 0
        for count in dict.fromkeys(
            [missed_grid.columns, missed_grid.rows, *range(1, _MOST_COLUMNS + 1)]
        ):
            placed = largest_group_row_column(found, count, spacing)
            if len(placed) > len(best):
                best, columns = placed, count
        if len(best) < max(_LEAST_TAGS, _LEAST_ARRANGED_FRACTION * len(found)):
            continue
        rows = 1 + max(row for _, row, _ in best)
        if given and rows < missed_grid.rows and columns == missed_grid.columns:
            rows = missed_grid.rows
        try:
            other = replace(missed_grid, columns=columns, rows=rows, spacing=spacing)
        except ConfigurationError:
            continue
        tags = np.full((rows * columns, 4, 2), np.nan)
        for each, _row, _column in best:
            tags[each.id] = each.corners
        seen, _edge = estimate_gap_ratio_and_edge_px(tags, other)
        seen = round(round(seen / _SPACING_STEP) * _SPACING_STEP, 6) if np.isfinite(seen) else 0.0
        if abs(seen - missed_grid.spacing) < 2.0 * _SPACING_STEP:
            seen = missed_grid.spacing
        if seen > 0.0:
            other = replace(other, spacing=seen)
        if other != missed_grid or not given:
            yield other


def _spacing(found: list[FoundSquare], asked: AprilGrid) -> float:
    """Median ratio of gap to edge of tags with consecutive numbers."""
    by_number = sorted(found, key=lambda each: each.id)
    ratios = []
    for first, second in pairwise(by_number):
        if second.id != first.id + 1:
            continue
        edge = float(np.linalg.norm(first.corners[1] - first.corners[0]))
        gap = float(np.linalg.norm(second.corners[0] - first.corners[1]))
        if gap < edge:  # else they are in two rows
            ratios.append(gap / edge)
    return float(np.median(ratios)) if ratios else asked.spacing
