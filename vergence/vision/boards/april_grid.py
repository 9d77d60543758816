"""Detection of AprilGrids, complete or in part."""

from collections.abc import Iterable
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.vision.boards.april_search import (
    CornerSearch,
    Tags,
    count_other_tags,
    known_corner_mask,
)
from vergence.vision.boards.april_tags import (
    SEARCH_SCALES,
    estimate_gap_ratio_and_edge_px,
    find_grid_tags,
    largest_group_row_column,
)
from vergence.vision.boards.homographies import origin_sigma_px
from vergence.vision.boards.smoothness import fit_smooth_homography
from vergence.vision.detection import Detection, Detector
from vergence.vision.tag_families import AprilGrid
from vergence.vision.tags.library import FoundSquare

_QUICK_METHODS: Final = (0, 1, 2)
"""Search methods of `SEARCH_SCALES` that are fast enough for a loop at camera rate (numerical:
indices)."""
_FIRST_PARTIAL_METHOD: Final = 1
"""First search method after which a partial board suffices (numerical: index)."""
_SUFFICIENT_FRACTION: Final = 0.97
"""Fraction of a board's corners that ends the search (chosen: completeness against time)."""
_LEAST_ARRANGED_FRACTION: Final = 0.5
"""Least fraction of the tags with the board's numbers that must be arranged as on the board
(chosen)."""
_MAX_OTHER_FRACTION: Final = 0.1
"""Most tags on the board's grid that the board has elsewhere or not at all, as a fraction of its
complete tags (chosen: stray tags against boards of other counts)."""
_LEAST_TAGS: Final = 2
"""Least number of tags whose print must be confirmed (chosen)."""
_LEAST_CONFIRMED_FRACTION: Final = 0.5
"""Least fraction of the tags beside the corners whose print must be confirmed (chosen)."""
_MAX_TRACKED_MOVE: Final = 0.3
"""Largest move of a tracked corner, as a fraction of the distance to the next edge (chosen)."""
_OFF_IMAGE_PX: Final = 1e5
"""Coordinate beyond all images and within single precision, px (numerical)."""
_SPACING_TOLERANCE: Final = 0.02
"""Tolerance of the ratio of gap to tag edge against the stated spacing (chosen: print errors)."""
_GAP_TOLERANCE_PX: Final = 0.5
"""Tolerance of the gap for small tags, px; the larger one holds (chosen: detection errors)."""
_DEFAULT_SIGMA_PX: Final = 0.1
"""Standard deviation of corners too few to estimate their noise, px (chosen)."""


class AprilGridDetector(Detector[AprilGrid]):
    """Detects an AprilGrid; the measured point is its centre.

    The search starts at tags that the AprilTag library reads. It predicts the neighbours of each
    from the board's layout, so that corners of tags too small, blurred or hidden to be read are
    found too. Each corner must have black and white around it as printed, and agree with a
    homography and a smooth lens distortion.
    """

    def _detect_some(self, image: NDArray[np.uint8], way: int | None = None) -> list[Detection]:
        methods = _QUICK_METHODS if way is None else (_QUICK_METHODS[way % len(_QUICK_METHODS)],)
        return self._search(image, image, np.zeros(2), methods)

    def _detect_all(self, image: NDArray[np.uint8]) -> list[Detection]:
        return self._search(image, image, np.zeros(2), range(len(SEARCH_SCALES)))

    def _detect_rest(self, image: NDArray[np.uint8]) -> list[Detection]:
        return self._search(
            image, image, np.zeros(2), range(len(_QUICK_METHODS), len(SEARCH_SCALES))
        )

    def _detect_in(
        self, image: NDArray[np.uint8], region: tuple[int, int, int, int], predicted: Detection
    ) -> list[Detection]:
        x0, y0, x1, y1 = region
        part = np.ascontiguousarray(image[y0:y1, x0:x1])
        return self._search(image, part, np.array([x0, y0], float), _QUICK_METHODS)

    def _refined(self, image: NDArray[np.uint8], predicted: Detection) -> Detection | None:
        return self._at(image, predicted.corners_px.reshape(-1, 4, 2), _MAX_TRACKED_MOVE)

    def _search(
        self,
        image: NDArray[np.uint8],
        part: NDArray[np.uint8],
        shift: NDArray[np.float64],
        methods: Iterable[int],
    ) -> list[Detection]:
        """Search a part of the image, at a shift in it, by some methods until one suffices."""
        best: Detection | None = None
        most = 0
        read: list[list[FoundSquare]] = []
        for method_index in methods:
            read.append(find_grid_tags(part, method_index))
            tags = self._tags(read[-1])
            found = None if tags is None else self._at(image, tags + shift)
            if found is not None:
                seen = int(np.isfinite(found.corners_px[:, 0]).sum())
                if seen > most:
                    best, most = found, seen
            if best is not None and (
                most >= _SUFFICIENT_FRACTION * len(best.corners_px)
                or method_index >= _FIRST_PARTIAL_METHOD
            ):
                break
        if best is None or any(map(self._exceeded_by, read)):
            return []
        tags = best.corners_px.reshape(-1, 4, 2)
        known = known_corner_mask(tags)
        others = count_other_tags(image, self.target, self._flat(tags[known]), tags)
        return [best] if others <= _MAX_OTHER_FRACTION * known.all(axis=1).sum() else []

    def _exceeded_by(self, found: list[FoundSquare]) -> bool:
        """True if tags are arranged as on a board of as many columns but more rows."""
        board = self.target
        placed = largest_group_row_column(found, board.columns, board.spacing)
        beyond = [each.id >= board.columns * board.rows for each, *_ in placed]
        return any(beyond) and not all(beyond)

    def _tags(self, found: list[FoundSquare]) -> Tags | None:
        """Corners of the tags that are arranged as on the board; None if too few."""
        board = self.target
        count = board.columns * board.rows
        placed = largest_group_row_column(found, board.columns, board.spacing)
        own = sum(each.id < count for each in found)
        if len(placed) < max(_LEAST_ARRANGED_FRACTION * own, 1) or any(
            each.id >= count for each, *_ in placed
        ):
            return None  # another layout, or a part of a larger board
        tags = np.full((count, 4, 2), np.nan)
        for each, _row, _column in placed:
            tags[each.id] = each.corners
        return tags

    def _at(
        self, image: NDArray[np.uint8], tags: Tags, step: float | None = None
    ) -> Detection | None:
        """Refine given corners and find the others; None if there is no board."""
        board = self.target
        tags = np.where(np.abs(tags) < _OFF_IMAGE_PX, tags, np.nan)
        # only complete tags; the corners of others are predicted from these
        there = np.repeat(known_corner_mask(tags).all(axis=1, keepdims=True), 4, axis=1)
        if not there.any():
            return None
        flat = self._flat(tags[there])
        search = CornerSearch(image, board, flat)
        search.refine_corners_of(there, tags, step)
        search.find_neighbouring_tags()
        known = np.flatnonzero(known_corner_mask(search.found))
        if len(known) < 4:
            return None
        corners, board_m = search.found.reshape(-1, 2)[known], board.corners_m[known]
        fit = fit_smooth_homography(
            board_m, flat.to_plane(corners), search.half_gaps_px()[known // 4]
        )
        if fit is None:
            return None
        known, corners, board_m = known[fit.inliers], corners[fit.inliers], board_m[fit.inliers]
        own = np.unique(known // 4)
        read = search.tags_matching_print(own)
        least = min(_LEAST_TAGS, board.columns * board.rows)
        if len(known) < 4 or read.sum() < max(least, _LEAST_CONFIRMED_FRACTION * len(own)):
            return None
        out, sigmas = np.full((2, len(board.corners_m), 2), np.nan)
        out[known] = corners
        ratio, edge = estimate_gap_ratio_and_edge_px(out.reshape(-1, 4, 2), board)
        if abs(ratio - board.spacing) > max(_SPACING_TOLERANCE, _GAP_TOLERANCE_PX / edge):
            return None
        grid_sigma_px = fit.residual_sigma_px or _DEFAULT_SIGMA_PX
        sigmas[known] = np.maximum(search.sigmas(known, corners, own), grid_sigma_px)
        middle = cv2.perspectiveTransform(np.zeros((1, 1, 2)), fit.homography)[0, 0]
        sigma = origin_sigma_px(fit.homography, board_m, sigmas[known])
        if (board_m.min(axis=0) < 0).all() and (board_m.max(axis=0) > 0).all():
            middle = middle + fit.origin_distortion_px
            sigma = np.hypot(sigma, fit.origin_distortion_sigma_px)
        point = flat.to_pixels(middle[None])[0]
        return Detection(board, point, out, sigma, sigmas)
