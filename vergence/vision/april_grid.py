"""Detection of AprilGrids, and of what other grid an image shows."""

import threading
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any, Final

import cv2
import numpy as np
import pyapriltags
from numpy.typing import NDArray

from vergence.errors import ConfigurationError
from vergence.vision.april_search import (
    CornerSearch,
    Tags,
    count_other_tags,
    fit_smooth_homography,
    known_corner_mask,
)
from vergence.vision.detection import Detection, Detector
from vergence.vision.optics import origin_sigma_px
from vergence.vision.tag_families import (
    CORRECTED_BITS,
    GRID_BORDER_BITS,
    GRID_FAMILY,
    AprilGrid,
    FoundSquare,
    library_family,
)

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
        return Detection(board, point, out, sigma, sigmas, camera=self.camera)


_SEARCH_METHODS: Final = (1, 3)
"""Search methods of `SEARCH_SCALES` that are tried (numerical: indices)."""
_MOST_COLUMNS: Final = 24
"""Largest number of columns that is tried (chosen: search time)."""
_LEAST_OTHER_TAGS: Final = 3
"""Least number of tags of a board (chosen)."""
_LEAST_OTHER_ARRANGED_FRACTION: Final = 0.6
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
        if len(found) < _LEAST_OTHER_TAGS:
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
        if len(best) < max(_LEAST_OTHER_TAGS, _LEAST_OTHER_ARRANGED_FRACTION * len(found)):
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
