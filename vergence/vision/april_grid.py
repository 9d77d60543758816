"""Detection of AprilGrids, whole or in part, and of what other grid an image shows."""

import threading
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from typing import Any, Final

import cv2
import numpy as np
import pyapriltags
from numpy.typing import NDArray

from vergence.errors import ConfigurationError
from vergence.vision.charuco import (
    LEAST_ARRANGED_FRACTION,
    alternative_columns,
    alternative_rows,
)
from vergence.vision.corners import (
    DEFAULT_SIGMA_PX,
    MAX_ENLARGED_PIXELS,
    WINDOW_FRACTION,
    WINDOW_PX,
    corner_sigmas,
    estimate_noise_grey,
    fit_smooth_homography,
    in_image,
    refine_and_check,
)
from vergence.vision.detection import Detection, Detector, Frame
from vergence.vision.optics import FlatView, fit_homography, origin_sigma_px
from vergence.vision.prints import (
    CORNER_PROBES,
    LEAST_CONFIRMED_FRACTION,
    MAX_OTHER_FRACTION,
    corner_contrasts,
    grey_at_pixels,
    least_corner_contrast,
    normalised,
)
from vergence.vision.tag_families import (
    CORRECTED_BITS,
    GRID_BORDER_BITS,
    GRID_FAMILY,
    AprilGrid,
    FoundSquare,
    library_family,
)

_CROSS: Final = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
_SEARCH_METHODS: Final = (
    (0.5, _CROSS, 1.0),
    (1.0, _CROSS, 1.0),
    (1.0, np.ones((2, 2), np.uint8), 0.5),
    (2.0, _CROSS, 1.0),
)
"""Search methods, quick ones first: image scale, kernel that dilates white, and inward move of a
tag's edges by it, px. The third reads bits of 2.5 px (chosen: small tags against time)."""
_LEAST_SIDE_PX: Final = 24
"""Smallest side of a scaled image that is searched, px (chosen)."""
_MAX_NEIGHBOUR_ERROR: Final = 0.35
"""Largest distance of a tag from its neighbour's prediction, in tag edges per row or column between
them (chosen: allows for lens distortion)."""
_MAX_NEIGHBOUR_STEPS: Final = 2
"""Most rows and columns between a tag and one that it predicts (chosen)."""
Tags = NDArray[np.float64]
"""Corners of tags, px, shape (tags, 4, 2); nan for unknown ones."""
_UNIT_SQUARE: Final = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], np.float32)
"""Corners of a tag in units of its edge (numerical)."""

_THREAD: Final = threading.local()
"""Holds the library's detector of each thread; it is not thread-safe."""


def find_grid_tags(image: NDArray[np.uint8], method_index: int) -> list[FoundSquare]:
    """Find tags with a border of two bits in an image, by one of `_SEARCH_METHODS`.

    The squares at the corners of tags connect all black to one region; dilating white by a pixel
    separates them. The corners are accurate to a pixel or two.
    """
    scale, kernel, shift_px = _SEARCH_METHODS[method_index]
    if min(image.shape) * scale < _LEAST_SIDE_PX or (
        scale > 1.0 and image.size > MAX_ENLARGED_PIXELS
    ):
        return []
    method = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_CUBIC
    sized = image if scale == 1.0 else cv2.resize(image, None, None, scale, scale, method)
    wide = cv2.dilate(sized, kernel)
    if not hasattr(_THREAD, "detector"):
        _THREAD.detector = _make_detector()
    found = []
    for each in _THREAD.detector.detect(np.ascontiguousarray(wide)):
        # the library has pixel edges at integers, and counts corners from the lower left
        corners = _widened(np.asarray(each.corners, float)[::-1], shift_px)
        found.append(FoundSquare(each.tag_id, each.hamming, corners / scale - 0.5))
    return found


def _widened(corners: NDArray[np.float64], by: float) -> NDArray[np.float64]:
    """Corners, (4, 2), of a quadrilateral with its edges moved outwards by a distance."""
    along = np.roll(corners, -1, axis=0) - corners
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    back = np.roll(along, 1, axis=0)
    sine = back[:, 0] * along[:, 1] - back[:, 1] * along[:, 0]
    return np.asarray(corners + by * (back - along) / np.maximum(np.abs(sine), 0.2)[:, None])


def _make_detector() -> Any:
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


_Placed = list[tuple[FoundSquare, int, int]]
"""Tags with their rows, counted from below, and columns."""


def _largest_group(tags: list[FoundSquare], columns: int, gap_to_edge_ratio: float) -> _Placed:
    """Largest connected group of tags, of different numbers, arranged as with so many columns.

    Only neighbours are compared: lens distortion bends a whole board, but hardly moves these
    relative to each other.
    """
    if not tags:
        return []
    numbers = np.array([each.id for each in tags])
    row, column = np.divmod(numbers, columns)
    corners = np.stack([each.corners for each in tags])
    edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).mean(axis=1)
    steps = np.maximum(np.abs(row[:, None] - row), np.abs(column[:, None] - column))
    fits = np.zeros(steps.shape, bool)
    for i in range(len(tags)):
        others = np.flatnonzero(steps[i] <= _MAX_NEIGHBOUR_STEPS)
        away = (1.0 + gap_to_edge_ratio) * np.stack(
            [column[others] - column[i], row[i] - row[others]], -1
        )
        predicted = _on_tag(away[None] + 0.5, corners[i])[0]
        beside = np.linalg.norm(predicted - corners[others].mean(axis=1), axis=1)
        most = _MAX_NEIGHBOUR_ERROR * np.maximum(steps[i, others], 1) * edge[others]
        fits[i, others] = beside < most
    fits &= fits.T
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


def _on_tag(places: NDArray[np.float64], corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pixels of places on a tag, in units of its edges, by its corners, (4, 2) px."""
    transform = cv2.getPerspectiveTransform(_UNIT_SQUARE, corners.astype(np.float32))
    return np.asarray(cv2.perspectiveTransform(places, transform))


def _tags_of(placed: _Placed, count: int) -> Tags:
    """Corners of the tags that are placed, of a number in all."""
    tags = np.full((count, 4, 2), np.nan)
    for each, _row, _column in placed:
        tags[each.id] = each.corners
    return tags


def _gap_ratio_and_edge_px(tags: Tags, target: AprilGrid) -> tuple[float, float]:
    """Median ratio of gap to tag edge and the mean edge, px; both nan without two neighbours."""
    grid = np.full((target.rows, target.columns, 4, 2), np.nan)
    grid[tuple(target.tag_cells.T)] = tags
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


_PROBE_FRACTION: Final = 0.45
"""Distance of grey samples from a corner along both axes, as a fraction of the distance to the next
edge (chosen)."""
_LEAST_TAG_CORRELATION: Final = 0.6
"""Least correlation of a tag's bits with its print; another tag has at most 0.4 (chosen)."""
_LEAST_OTHER_TAG_CORRELATION: Final = 0.7
"""Least correlation of a tag's bits with any print of the family; noise reaches it at one place in
100 (chosen)."""
_LEAST_OTHER_CORNERS: Final = 2
"""Least corners of a tag, found on the board's grid, that may show another board (chosen)."""
_TAG_BITS: Final = len(AprilGrid().tag_bits(0))
"""Bits along a tag's edge (physical: Kalibr's boards)."""
_MAX_PREDICTING_CORNERS: Final = 12
"""Most corners that predict a neighbouring tag (chosen: averaging against lens distortion)."""


def known_corner_mask(tags: Tags) -> NDArray[np.bool_]:
    """Mask of the known corners, (tags, 4)."""
    return np.asarray(np.isfinite(tags).all(axis=-1))


class CornerSearch:
    """Search for a board's corners: `found` ones, and `predicted` ones of tags tried; else nan."""

    def __init__(self, image: NDArray[np.uint8], board: AprilGrid, flat: FlatView) -> None:
        count = board.columns * board.rows
        self.found, self.predicted = np.full((2, count, 4, 2), np.nan)
        self._image = image
        self._board = board
        self._flat = flat
        self._least_contrast = np.nan
        # distance from a corner to the next edge, as a ratio to a tag's edge
        self._free = min(board.spacing, 2.0 * board.bit_m / board.tag_m)
        self._half_sides_px = np.zeros(count, int)
        self._corners_m = board.corners_m.reshape(-1, 4, 2)

    def refine_corners_of(
        self, wanted: NDArray[np.bool_], predicted: Tags, step: float | None = None
    ) -> None:
        """Refine wanted corners, (tags, 4), and drop those without the printed contrast.

        Of their tags all four corners are predicted. `step` is the largest move as a fraction of
        the distance to the next edge; None for the window's reach.
        """
        numbers, own = np.nonzero(wanted)
        if not len(numbers):
            return
        self.predicted[wanted] = predicted[wanted]
        lengths = np.linalg.norm(predicted - np.roll(predicted, 1, axis=1), axis=-1)[numbers]
        free = self._free * np.nan_to_num(np.nanmin(lengths, axis=1))
        half_sides_px = np.clip(np.rint(WINDOW_FRACTION * free), *WINDOW_PX).astype(int)
        self._half_sides_px[numbers] = half_sides_px
        start = predicted[wanted]
        places = np.full(start.shape, np.nan)
        inside = in_image(self._image, start)
        for half_side_px in np.unique(half_sides_px[inside]).tolist():
            chosen = np.flatnonzero(inside & (half_sides_px == half_side_px))
            refined, moved, settled = refine_and_check(self._image, start[chosen], half_side_px)
            limit = half_side_px + 1.0 if step is None else np.maximum(step * free[chosen], 1.0)
            good = settled & (moved <= limit) & in_image(self._image, refined)
            places[chosen[good]] = refined[good]
        self.found[numbers, own] = places
        tags = np.unique(numbers)
        contrast = np.full(wanted.shape, np.nan)
        contrast[tags] = self._contrasts(tags)
        seen = contrast[wanted & np.isfinite(contrast)]
        if np.isnan(self._least_contrast) and len(seen):
            self._least_contrast = least_corner_contrast(seen)
        self.found[wanted & ~(contrast > self._least_contrast)] = np.nan

    def find_neighbouring_tags(self) -> None:
        """Search for tags next to those found, repeatedly outwards."""
        tried = np.asarray(known_corner_mask(self.found).any(axis=1), np.bool_)
        while len(new := self.refine_neighbours_of_whole_tags(tried)):
            tried[new] = True
            seen = new[np.isfinite(self.predicted[new]).all(axis=(1, 2))]
            self.found[np.setdiff1d(new, seen[self.tags_matching_print(seen)])] = np.nan
        there = known_corner_mask(self.found)
        self._refine_beside(np.flatnonzero(there.any(axis=1) & ~there.all(axis=1)), np.inf)

    def refine_neighbours_of_whole_tags(self, tried: NDArray[np.bool_]) -> NDArray[np.intp]:
        """Refine the corners of untried tags next to complete ones; return their numbers."""
        places, whole = self._board.tag_cells, known_corner_mask(self.found).all(axis=1)
        apart = np.abs(places[:, None] - places).max(axis=-1)
        new = np.flatnonzero(~tried & ((apart <= 1) & whole).any(axis=1))
        # the near corners first, since a lens distorts less over a gap than over a tag
        self._refine_beside(new, 1.01 * self._board.spacing * self._board.tag_m)
        self._refine_beside(new, np.inf)
        return new

    def _refine_beside(self, numbers: NDArray[np.intp], most_m: float) -> None:
        """Refine missing corners of some tags, predicted from the corners around them.

        Only those up to a distance on the board from the nearest known corner are refined.
        """
        there = known_corner_mask(self.found)
        predicted, wanted = np.full(self.found.shape, np.nan), np.zeros(there.shape, bool)
        known_m, known = self._corners_m[there], self._flat.to_plane(self.found[there])
        for number in numbers.tolist():
            corners_m = self._corners_m[number]
            away = np.linalg.norm(known_m - corners_m.mean(axis=0), axis=1)
            used = np.argsort(away)[:_MAX_PREDICTING_CORNERS]
            used = used[away[used] < away[used[0]] + 1.5 * self._board.tag_m]
            transform = fit_homography(known_m[used], known[used]) if len(used) > 3 else None
            if transform is None:
                continue
            ideal = cv2.perspectiveTransform(corners_m[None], transform)[0]
            predicted[number] = self._flat.to_pixels(ideal)
            apart_m = np.linalg.norm(corners_m[:, None] - known_m, axis=-1)
            wanted[number] = ~there[number] & (apart_m.min(axis=1) < most_m)
        wanted &= np.isfinite(predicted).all(axis=-1)
        self.predicted[numbers] = np.where(
            there[numbers][..., None], self.predicted[numbers], predicted[numbers]
        )
        self.refine_corners_of(wanted, predicted)

    def tags_matching_print(self, numbers: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Mask of the tags of some numbers whose image agrees with their print."""
        alike = (self._codes(numbers) * _printed_codes()[numbers]).sum(axis=1)
        return np.asarray(alike > _LEAST_TAG_CORRELATION)

    def read_numbers(self, numbers: NDArray[np.intp]) -> NDArray[np.intp]:
        """Numbers that the image shows at some tags of the board, -1 where none can be read."""
        alike = self._codes(numbers) @ _printed_codes().T
        shown = alike.max(axis=1) > _LEAST_OTHER_TAG_CORRELATION
        return np.where(shown, alike.argmax(axis=1), -1)

    def _codes(self, numbers: NDArray[np.intp]) -> NDArray[np.float64]:
        """Grey levels of tags' codes, as `_printed_codes`."""
        middles = (np.arange(GRID_BORDER_BITS, _TAG_BITS - GRID_BORDER_BITS) + 0.5) / _TAG_BITS
        cells = np.stack(np.meshgrid(middles, middles), axis=-1).reshape(-1, 2)
        return normalised(grey_at_pixels(self._image, self._seen(numbers, cells)))

    def sigmas(
        self, indices: NDArray[np.intp], corners: NDArray[np.float64], numbers: NDArray[np.intp]
    ) -> NDArray[np.float64]:
        """Standard deviations of corners of some indices and tags due to pixel noise, (n, 2) px."""
        half = 0.5 * self._board.spacing
        gaps = np.array([[0.5, -half], [1.0 + half, 0.5], [0.5, 1.0 + half], [-half, 0.5]])
        noise = estimate_noise_grey(self._image, self._seen(numbers, gaps).reshape(-1, 2))
        half_sides_px = self._half_sides_px[indices // 4]
        out = np.empty(corners.shape)
        for half_side_px in np.unique(half_sides_px).tolist():
            own = half_sides_px == half_side_px
            out[own] = corner_sigmas(self._image, corners[own], half_side_px, noise)
        return out

    def _contrasts(self, numbers: NDArray[np.intp]) -> NDArray[np.float64]:
        """Contrast of white to black around each corner, (tags, 4) grey levels; nan if unknown."""
        steps = _PROBE_FRACTION * self._free * CORNER_PROBES
        places = self._seen(numbers, (_UNIT_SQUARE[:, None] + steps).reshape(-1, 2))
        greys = grey_at_pixels(self._image, places).reshape(-1, 4, 4)
        contrast = corner_contrasts(greys, np.array([1.0, -1.0, 1.0, -1.0]))
        contrast[~known_corner_mask(self.found[numbers])] = np.nan
        return contrast

    def _seen(self, numbers: NDArray[np.intp], places: NDArray[np.float64]) -> NDArray[np.float64]:
        """Pixels of positions on tags, in units of their edges, shape (tags, n, 2)."""
        out = np.empty((len(numbers), len(places), 2))
        for i, number in enumerate(numbers.tolist()):
            found = self.found[number]
            corners = np.where(np.isfinite(found), found, self.predicted[number])
            out[i] = _on_tag(places[None], corners)[0]
        return out


def _count_other_tags(
    image: NDArray[np.uint8], board: AprilGrid, flat: FlatView, tags: Tags
) -> int:
    """Count tags next to found ones, on a board's grid, where the board has another tag or none."""
    columns = board.columns + 2
    if columns * (board.rows + 2) > len(board.code.code_words):
        return 0
    around = replace(board, columns=columns, rows=board.rows + 2)
    # the board in the middle of this one
    own = np.arange(len(tags)).reshape(board.rows, board.columns)
    numbers = np.pad(own, 1, constant_values=-1).ravel()
    search = CornerSearch(image, around, flat)
    placed = np.full(search.found.shape, np.nan)
    placed[numbers >= 0] = tags
    whole = np.asarray(known_corner_mask(placed).all(axis=1), np.bool_)
    search.refine_corners_of(np.repeat(whole[:, None], 4, axis=1), placed)
    beside = search.refine_neighbours_of_whole_tags(whole)
    seen = beside[known_corner_mask(search.found[beside]).sum(axis=1) >= _LEAST_OTHER_CORNERS]
    read = search.read_numbers(seen)
    return int(((read >= 0) & (read != numbers[seen])).sum())


@lru_cache(maxsize=1)
def _printed_codes() -> NDArray[np.float64]:
    """Codes of all tags of the family, row by row, normalised, shape (tags, bits)."""
    board = AprilGrid()
    code = slice(GRID_BORDER_BITS, _TAG_BITS - GRID_BORDER_BITS)  # borders are equal in all tags
    numbers = range(len(board.code.code_words))
    return normalised(
        np.array([board.tag_bits(number)[code, code].ravel() for number in numbers], float)
    )


_QUICK_METHODS: Final = (0, 1, 2)
"""Search methods that are fast enough for a loop at camera rate (numerical: indices)."""
_FIRST_PARTIAL_METHOD: Final = 1
"""First search method after which a partial board suffices (numerical: index)."""
_SUFFICIENT_FRACTION: Final = 0.97
"""Fraction of a board's corners that ends the search (chosen: completeness against time)."""
_LEAST_OWN_ARRANGED_FRACTION: Final = 0.5
"""Least fraction of the tags with the board's numbers that must be arranged as on the board
(chosen)."""
_LEAST_TAGS: Final = 2
"""Least number of tags whose print must be confirmed (chosen)."""
_MAX_TRACKED_MOVE: Final = 0.3
"""Largest move of a tracked corner, as a fraction of the distance to the next edge (chosen)."""
_OFF_IMAGE_PX: Final = 1e5
"""Coordinate beyond all images and within single precision, px (numerical)."""
_SPACING_TOLERANCE: Final = 0.02
"""Tolerance of the ratio of gap to tag edge against the stated spacing (chosen: print errors)."""
_GAP_TOLERANCE_PX: Final = 0.5
"""Tolerance of the gap for small tags, px; the larger one holds (chosen: detection errors)."""


class AprilGridDetector(Detector[AprilGrid]):
    """Detects an AprilGrid; the measured point is its centre.

    The search starts at tags that the AprilTag library reads. It predicts the neighbours of each
    from the board's layout, so that corners of tags too small, blurred or hidden to be read are
    found too. Each corner must have black and white around it as printed, and agree with a
    homography and a smooth lens distortion.
    """

    def _detect_some(self, frame: Frame, way: int | None = None) -> list[Detection]:
        methods = _QUICK_METHODS if way is None else (_QUICK_METHODS[way % len(_QUICK_METHODS)],)
        return self._search(frame.grey, methods)

    def _detect_all(self, frame: Frame) -> list[Detection]:
        return self._search(frame.grey, range(len(_SEARCH_METHODS)))

    def _detect_rest(self, frame: Frame) -> list[Detection]:
        return self._search(frame.grey, range(len(_QUICK_METHODS), len(_SEARCH_METHODS)))

    def _detect_in(
        self, frame: Frame, region: tuple[int, int, int, int], predicted: Detection
    ) -> list[Detection]:
        return self._search(frame.grey, _QUICK_METHODS, region)

    def _refined(self, frame: Frame, predicted: Detection) -> Detection | None:
        return self._at(frame.grey, predicted.corners_px.reshape(-1, 4, 2), _MAX_TRACKED_MOVE)

    def _search(
        self,
        image: NDArray[np.uint8],
        methods: Iterable[int],
        region: tuple[int, int, int, int] | None = None,
    ) -> list[Detection]:
        """Search the image, or a region of it, by some methods until one suffices."""
        height, width = image.shape
        x0, y0, x1, y1 = region or (0, 0, width, height)
        part = np.ascontiguousarray(image[y0:y1, x0:x1])
        board, count = self.target, self.target.columns * self.target.rows
        sufficient = _SUFFICIENT_FRACTION * 4 * count
        best: Detection | None = None
        most, exceeded = 0, False
        for method_index in methods:
            squares = find_grid_tags(part, method_index)
            placed = _largest_group(squares, board.columns, board.spacing)
            beyond = [each.id >= count for each, *_ in placed]
            # arranged as on a board of as many columns but more rows
            exceeded |= any(beyond) and not all(beyond)
            own = sum(each.id < count for each in squares)
            # else it is another layout, or a part of a larger board
            if len(placed) >= max(_LEAST_OWN_ARRANGED_FRACTION * own, 1) and not any(beyond):
                found = self._at(image, _tags_of(placed, count) + (x0, y0))
                seen = 0 if found is None else int(np.isfinite(found.corners_px[:, 0]).sum())
                if seen > most:
                    best, most = found, seen
            enough = method_index >= _FIRST_PARTIAL_METHOD or most >= sufficient
            if best is not None and enough:
                break
        if best is None or exceeded:
            return []
        tags = best.corners_px.reshape(-1, 4, 2)
        known = known_corner_mask(tags)
        others = _count_other_tags(image, board, self._flat(tags[known]), tags)
        return [best] if others <= MAX_OTHER_FRACTION * known.all(axis=1).sum() else []

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
        edges = search.predicted - np.roll(search.predicted, 1, axis=1)
        half_gaps_px = 0.5 * board.spacing * np.linalg.norm(edges, axis=-1).min(axis=1)
        fit = fit_smooth_homography(board_m, flat.to_plane(corners), half_gaps_px[known // 4])
        if fit is None:
            return None
        known, corners, board_m = known[fit.inliers], corners[fit.inliers], board_m[fit.inliers]
        own = np.unique(known // 4)
        read = search.tags_matching_print(own)
        least = min(_LEAST_TAGS, board.columns * board.rows)
        if len(known) < 4 or read.sum() < max(least, LEAST_CONFIRMED_FRACTION * len(own)):
            return None
        out, sigmas = np.full((2, len(board.corners_m), 2), np.nan)
        out[known] = corners
        ratio, edge = _gap_ratio_and_edge_px(out.reshape(-1, 4, 2), board)
        if abs(ratio - board.spacing) > max(_SPACING_TOLERANCE, _GAP_TOLERANCE_PX / edge):
            return None
        grid_sigma_px = fit.residual_sigma_px or DEFAULT_SIGMA_PX
        sigmas[known] = np.maximum(search.sigmas(known, corners, own), grid_sigma_px)
        middle = cv2.perspectiveTransform(np.zeros((1, 1, 2)), fit.homography)[0, 0]
        sigma = origin_sigma_px(fit.homography, board_m, sigmas[known])
        if (board_m.min(axis=0) < 0).all() and (board_m.max(axis=0) > 0).all():
            middle = middle + fit.origin_distortion_px
            sigma = np.hypot(sigma, fit.origin_distortion_sigma_px)
        point = flat.to_pixels(middle[None])[0]
        return Detection(board, point, out, sigma, sigmas, camera=self.camera)


_OTHER_GRID_METHODS: Final = (1, 3)
"""Search methods that are tried for other boards (numerical: indices)."""
_LEAST_OTHER_TAGS: Final = 3
"""Least number of tags of a board (chosen)."""
_SPACING_STEP: Final = 0.01
"""Resolution of estimated spacings (chosen: spacings are round numbers)."""


def alternative_grids(
    image: NDArray[np.uint8], missed_grid: AprilGrid | None
) -> Iterator[AprilGrid]:
    """Boards other than the one that was not found, or any, that explain the tags in an image.

    They have the number of columns that most tags agree with, as many rows as the tags need, the
    estimated spacing, and the edge of the missed board's tags.
    """
    asked = missed_grid or AprilGrid()
    for method_index in _OTHER_GRID_METHODS:
        found = find_grid_tags(image, method_index)
        if len(found) < _LEAST_OTHER_TAGS:
            continue
        spacing = _spacing(found, asked)
        groups = {
            columns: _largest_group(found, columns, spacing)
            for columns in alternative_columns(asked, 1)
        }
        columns, best = max(groups.items(), key=lambda each: len(each[1]))
        if len(best) < max(_LEAST_OTHER_TAGS, LEAST_ARRANGED_FRACTION * len(found)):
            continue
        rows = 1 + max(row for _, row, _ in best)
        if missed_grid is not None:
            rows = alternative_rows(missed_grid, columns, rows)
        try:
            other = replace(asked, columns=columns, rows=rows, spacing=spacing)
        except ConfigurationError:
            continue
        seen, _edge = _gap_ratio_and_edge_px(_tags_of(best, rows * columns), other)
        seen = round(round(seen / _SPACING_STEP) * _SPACING_STEP, 6) if np.isfinite(seen) else 0.0
        if abs(seen - asked.spacing) < 2.0 * _SPACING_STEP:
            seen = asked.spacing
        if seen > 0.0:
            other = replace(other, spacing=seen)
        if other != missed_grid:
            yield other


def _spacing(found: list[FoundSquare], asked: AprilGrid) -> float:
    """Median ratio of gap to edge of tags with consecutive numbers."""
    by_id = sorted(found, key=lambda each: each.id)
    pairs = [(a.corners, b.corners) for a, b in pairwise(by_id) if b.id == a.id + 1]
    ratios = [np.linalg.norm(b[0] - a[1]) / np.linalg.norm(a[1] - a[0]) for a, b in pairs]
    in_row = [ratio for ratio in ratios if ratio < 1.0]
    return float(np.median(in_row)) if in_row else asked.spacing
