"""Tell a board that has fewer rows than the one asked for, whose other rows have its numbers."""

from collections import defaultdict
from dataclasses import replace
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.errors import ConfigurationError
from vergence.vision import Detection
from vergence.vision.boards.homographies import fit_homography
from vergence.vision.boards.markers import upper_left_is_dark
from vergence.vision.tag_families import AprilGrid
from vergence.vision.targets import CharucoBoard, PlanarTarget

_MARGIN_SQUARES: Final = 1.25
"""Room in the image around a corner of a ChArUco board that is expected, in squares: the markers
beside it with white around them (chosen)."""
_SIDES: Final = np.array([[-1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [0.0, 1.0]])
"""Directions to the four sides (numerical)."""


class UnseenRowCheck:
    """Tells if no image shows the last rows of a board, although most show their place."""

    def __init__(self) -> None:
        self._rows: dict[PlanarTarget, list[NDArray[np.bool_]]] = defaultdict(list)

    def add(self, found: Detection, shape: tuple[int, ...]) -> None:
        """Add a detection in an image of shape (height, width, ...)."""
        if isinstance(found.target, AprilGrid | CharucoBoard):
            self._rows[found.target].append(rows_seen_and_in_view(found, shape))

    def fitting_boards(self) -> dict[PlanarTarget, PlanarTarget]:
        """Get the board of fewer rows that fits the images, for each target that has too many."""
        out: dict[PlanarTarget, PlanarTarget] = {}
        for target, views in self._rows.items():
            seen, in_view = np.stack(views, axis=1)
            last = int(np.flatnonzero(seen.any(axis=0))[-1])
            if last + 1 < seen.shape[1] and in_view[:, last + 1].mean() > 0.5:
                other = _with_rows(target, last + 1)
                if other is not None:
                    out[target] = other
        return out

    def notes(self) -> list[str]:
        """One line for each board whose last rows are in no image."""
        return [
            f"{target}: its last row is in 0 of {len(self._rows[target])} images, though its place "
            f"is in view: if nothing covers it, the board is {other}, whose middle is elsewhere"
            for target, other in self.fitting_boards().items()
        ]


def rows_seen_and_in_view(found: Detection, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Find the rows of a board with corners, and those whose place is well inside the image.

    Args:
        found: an AprilGrid or a ChArUco board.
        shape: (height, width, ...) of the image.

    Returns:
        (2, rows) both masks, from the row of the first number; rows of inner corners for ChArUco.
    """
    target = found.target
    assert isinstance(target, AprilGrid | CharucoBoard)
    if isinstance(target, AprilGrid):
        rows, margin_m = target.rows, target.spacing * target.tag_m
    else:
        rows, margin_m = target.rows - 1, _MARGIN_SQUARES * target.square_m
    known = np.isfinite(found.corners_px).all(axis=1)
    transform = fit_homography(target.corners_m[known], found.corners_px[known])
    if transform is None:
        in_view = known
    else:
        around_m = target.corners_m[:, None] + margin_m * _SIDES
        places = cv2.perspectiveTransform(around_m, transform)
        in_view = ((places > 0.0) & (places < (shape[1] - 1.0, shape[0] - 1.0))).all(axis=(1, 2))
    return np.stack([known.reshape(rows, -1).any(axis=1), in_view.reshape(rows, -1).all(axis=1)])


def _with_rows(target: PlanarTarget, count: int) -> PlanarTarget | None:
    """The board whose corners are in the first rows; None if there is none of that layout."""
    if isinstance(target, AprilGrid):
        return replace(target, rows=count)
    assert isinstance(target, CharucoBoard)
    dark = upper_left_is_dark(target)
    if not dark and count % 2 == 0:
        return None
    try:
        return replace(target, rows=count + 1, legacy=not dark)
    except ConfigurationError:  # too few rows
        return None
