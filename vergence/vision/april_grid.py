"""Detection of AprilGrids, whole or in part, and of what other grid an image shows."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.errors import ConfigurationError
from vergence.models.parts import FloatArray
from vergence.vision.charuco import LEAST_ARRANGED_FRACTION, alternative_columns
from vergence.vision.corners import (
    DEFAULT_SIGMA_PX,
    MAX_ENLARGED_PIXELS,
    WINDOW_FRACTION,
    WINDOW_PX,
    fit_smooth_homography,
    in_image,
    pixel_noise_grey,
    refine_and_check,
)
from vergence.vision.detection import BoardDetection, BoardDetector, Frame, Region, cut_out
from vergence.vision.optics import FlatView, Image, fit_homography, origin_sigma_px
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
    GRID_BORDER_BITS,
    GRID_FAMILY,
    AprilGrid,
    FoundSquare,
    find_squares,
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
Tags = FloatArray
"""Corners of tags, px, shape (tags, 4, 2); nan for unknown ones."""
_UNIT_SQUARE: Final = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], np.float32)
"""Corners of a tag in units of its edge (numerical)."""


def find_grid_tags(image: Image, method_index: int) -> list[FoundSquare]:
    """Find tags with a border of two bits in an image, by one of `_SEARCH_METHODS`.

    The squares at the corners of tags connect all black to one region; dilating white by a pixel
    separates them. The corners are accurate to a pixel or two.
    """
    scale, kernel, shift_px = _SEARCH_METHODS[method_index]
    if min(image.shape) * scale < _LEAST_SIDE_PX or (
        scale > 1.0 and image.size > MAX_ENLARGED_PIXELS
    ):
        return []
    wide = cv2.dilate(cut_out(image, scale=scale).image, kernel)
    return [
        each._replace(corners=_widened(each.corners + 0.5, shift_px) / scale - 0.5)
        for each in find_squares(np.asarray(wide, np.uint8), GRID_FAMILY, GRID_BORDER_BITS)
    ]


def _widened(corners: FloatArray, by: float) -> FloatArray:
    """Corners, (4, 2), of a quadrilateral with its edges moved outwards by a distance."""
    along = np.roll(corners, -1, axis=0) - corners
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    back = np.roll(along, 1, axis=0)
    sine = back[:, 0] * along[:, 1] - back[:, 1] * along[:, 0]
    return np.asarray(corners + by * (back - along) / np.maximum(np.abs(sine), 0.2)[:, None])


def _largest_group(
    tags: list[FoundSquare], columns: int, gap_to_edge_ratio: float
) -> list[FoundSquare]:
    """Largest connected group of tags arranged as with so many columns, one of each number."""
    if not tags:
        return []
    numbers = np.array([each.id for each in tags])
    row, column = np.divmod(numbers, columns)
    corners = np.stack([each.corners for each in tags])
    edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).mean(axis=1)
    steps = np.maximum(np.abs(row[:, None] - row), np.abs(column[:, None] - column))
    fits = np.zeros(steps.shape, bool)
    for i in range(len(tags)):
        # only neighbours: lens distortion bends a whole board, but hardly moves these
        others = np.flatnonzero(steps[i] <= _MAX_NEIGHBOUR_STEPS)
        away = (1.0 + gap_to_edge_ratio) * np.stack(
            [column[others] - column[i], row[i] - row[others]], -1
        )
        predicted = _on_tag(away[None] + 0.5, corners[i])[0]
        beside = np.linalg.norm(predicted - corners[others].mean(axis=1), axis=1)
        most = _MAX_NEIGHBOUR_ERROR * np.maximum(steps[i, others], 1) * edge[others]
        fits[i, others] = beside < most
    fits = (fits & fits.T & (numbers[:, None] != numbers)) | np.eye(len(tags), dtype=bool)
    group, before = np.arange(len(tags)), np.array([])
    while not np.array_equal(group, before):  # each joins the first group that it touches
        group, before = np.where(fits, group, len(tags)).min(axis=1), group
    different = [
        np.unique(np.where(group == k, numbers, -1), return_index=True) for k in range(len(tags))
    ]
    first = max((index[number >= 0] for number, index in different), key=len)
    return [tags[i] for i in first]


def _on_tag(places: FloatArray, corners: FloatArray) -> FloatArray:
    """Pixels of places on a tag, in units of its edges, by its corners, (4, 2) px."""
    transform = cv2.getPerspectiveTransform(_UNIT_SQUARE, corners.astype(np.float32))
    return np.asarray(cv2.perspectiveTransform(places, transform))


def _tags_of(found: list[FoundSquare], count: int) -> Tags:
    """Corners of the tags that are found, of a number in all."""
    tags = np.full((count, 4, 2), np.nan)
    for each in found:
        tags[each.id] = each.corners
    return tags


def _gap_ratio_and_edge_px(tags: Tags, target: AprilGrid) -> tuple[float, float]:
    """Median ratio of gap to tag edge and the mean edge, px; both nan without two neighbours."""
    grid = np.full((target.rows, target.columns, 4, 2), np.nan)
    grid[tuple(target.tag_cells.T)] = tags
    ratios, lengths = [np.empty(0)], [np.empty(0)]
    for side, start, end in (
        (grid, 0, 1), (grid, 3, 2), (grid.swapaxes(0, 1), 0, 3), (grid.swapaxes(0, 1), 1, 2)
    ):  # fmt: skip
        edge = np.linalg.norm(side[:, :, end] - side[:, :, start], axis=-1)
        gap = np.linalg.norm(side[:, 1:, start] - side[:, :-1, end], axis=-1)
        mean = 0.5 * (edge[:, 1:] + edge[:, :-1])
        there = np.isfinite(gap / mean)
        ratios.append((gap / mean)[there])
        lengths.append(mean[there])
    if not np.concatenate(ratios).size:
        return np.nan, np.nan
    return float(np.median(np.concatenate(ratios))), float(np.concatenate(lengths).mean())


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

    def __init__(self, image: Image, board: AprilGrid, flat: FlatView) -> None:
        self.found, self.predicted, self._unit_sigmas = np.full(
            (3, board.columns * board.rows, 4, 2), np.nan
        )
        self._image = image
        self._board = board
        self._flat = flat
        self._least_contrast = np.nan
        # distance from a corner to the next edge, as a ratio to a tag's edge
        self._free = min(board.spacing, 2.0 * board.bit_m / board.tag_m)
        self._corners_m = board.corners_m.reshape(-1, 4, 2)

    @property
    def known(self) -> NDArray[np.bool_]:
        """(tags, 4) mask of the corners found."""
        return known_corner_mask(self.found)

    def refine_corners_of(
        self, wanted: NDArray[np.bool_], predicted: Tags, step: float | None = None
    ) -> None:
        """Refine wanted corners, (tags, 4), and drop those without the printed contrast.

        Of their tags all four corners are predicted. `step` is the largest move as a fraction of
        the distance to the next edge; None for the window's reach.
        """
        if not wanted.any():
            return
        numbers = np.nonzero(wanted)[0]
        self.predicted[wanted] = start = predicted[wanted]
        lengths = np.linalg.norm(predicted - np.roll(predicted, 1, axis=1), axis=-1)[numbers]
        free = self._free * np.nan_to_num(np.nanmin(lengths, axis=1))
        half_sides_px = np.clip(np.rint(WINDOW_FRACTION * free), *WINDOW_PX).astype(int)
        places, sigmas = np.full((2, *start.shape), np.nan)
        inside = in_image(self._image, start)
        for half_side_px in np.unique(half_sides_px[inside]).tolist():
            chosen = np.flatnonzero(inside & (half_sides_px == half_side_px))
            refined, moved, settled, sigmas[chosen] = refine_and_check(
                self._image, start[chosen], half_side_px
            )
            limit = half_side_px + 1.0 if step is None else np.maximum(step * free[chosen], 1.0)
            good = settled & (moved <= limit) & in_image(self._image, refined)
            places[chosen[good]] = refined[good]
        self.found[wanted], self._unit_sigmas[wanted] = places, sigmas
        tags = np.unique(numbers)
        probes = _UNIT_SQUARE[:, None] + _PROBE_FRACTION * self._free * CORNER_PROBES
        greys = self._greys(tags, probes.reshape(-1, 2)).reshape(-1, 4, 4)
        contrast = np.full(wanted.shape, np.nan)
        contrast[tags] = corner_contrasts(greys, np.array([1.0, -1.0, 1.0, -1.0]))
        seen = contrast[wanted & self.known]
        if np.isnan(self._least_contrast) and len(seen):
            self._least_contrast = least_corner_contrast(seen)
        self.found[wanted & ~(contrast > self._least_contrast)] = np.nan

    def find_neighbouring_tags(self) -> None:
        """Search for tags next to those found, repeatedly outwards."""
        tried = np.asarray(self.known.any(axis=1), np.bool_)
        while len(new := self.refine_neighbours_of_whole_tags(tried)):
            tried[new] = True
            seen = new[np.isfinite(self.predicted[new]).all(axis=(1, 2))]
            self.found[np.setdiff1d(new, seen[self.tags_matching_print(seen)])] = np.nan
        cut = self.known.any(axis=1) & ~self.known.all(axis=1)
        self._refine_beside(np.flatnonzero(cut), np.inf)

    def refine_neighbours_of_whole_tags(self, tried: NDArray[np.bool_]) -> NDArray[np.intp]:
        """Refine the corners of untried tags next to complete ones; return their numbers."""
        places, whole = self._board.tag_cells, self.known.all(axis=1)
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
        there = self.known
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

    def _codes(self, numbers: NDArray[np.intp]) -> FloatArray:
        """Grey levels of tags' codes, as `_printed_codes`."""
        middles = (np.arange(GRID_BORDER_BITS, _TAG_BITS - GRID_BORDER_BITS) + 0.5) / _TAG_BITS
        cells = np.stack(np.meshgrid(middles, middles), axis=-1).reshape(-1, 2)
        return normalised(self._greys(numbers, cells))

    def sigmas(self, indices: NDArray[np.intp], numbers: NDArray[np.intp]) -> FloatArray:
        """Standard deviations of corners of some indices and tags due to pixel noise, (n, 2) px."""
        half = 0.5 * self._board.spacing
        gaps = np.array([[0.5, -half], [1.0 + half, 0.5], [0.5, 1.0 + half], [-half, 0.5]])
        noise = pixel_noise_grey(self._image, self._seen(numbers, gaps).reshape(-1, 2))
        return noise * self._unit_sigmas.reshape(-1, 2)[indices]

    def _greys(self, numbers: NDArray[np.intp], places: FloatArray) -> FloatArray:
        """Grey levels, (tags, n), at positions on tags, see `_seen`."""
        return grey_at_pixels(self._image, self._seen(numbers, places))

    def _seen(self, numbers: NDArray[np.intp], places: FloatArray) -> FloatArray:
        """Pixels of positions on tags, in units of their edges, shape (tags, n, 2)."""
        corners = np.where(self.known[..., None], self.found, self.predicted)[numbers]
        pixels = [_on_tag(places[None], each)[0] for each in corners]
        return np.reshape(pixels, (len(numbers), len(places), 2))


def _count_other_tags(image: Image, board: AprilGrid, flat: FlatView, tags: Tags) -> int:
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
    seen = beside[search.known[beside].sum(axis=1) >= _LEAST_OTHER_CORNERS]
    read = search.read_numbers(seen)
    return int(((read >= 0) & (read != numbers[seen])).sum())


@lru_cache(maxsize=1)
def _printed_codes() -> FloatArray:
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


class AprilGridDetector(BoardDetector[AprilGrid]):
    """Detects an AprilGrid; the measured point is its centre.

    The search starts at tags that the AprilTag library reads. It predicts the neighbours of each
    from the board's layout, so that corners of tags too small, blurred or hidden to be read are
    found too. Each corner must have black and white around it as printed, and agree with a
    homography and a smooth lens distortion.
    """

    def _detect_some(self, frame: Frame, way: int | None = None) -> list[BoardDetection]:
        methods = _QUICK_METHODS if way is None else (_QUICK_METHODS[way % len(_QUICK_METHODS)],)
        return self._search(frame.grey, methods)

    def _detect_all(self, frame: Frame) -> list[BoardDetection]:
        return self._search(frame.grey, range(len(_SEARCH_METHODS)))

    def _detect_rest(self, frame: Frame) -> list[BoardDetection]:
        return self._search(frame.grey, range(len(_QUICK_METHODS), len(_SEARCH_METHODS)))

    def _detect_in(
        self, frame: Frame, region: Region, predicted: BoardDetection
    ) -> list[BoardDetection]:
        return self._search(frame.grey, _QUICK_METHODS, region)

    def _refined(self, frame: Frame, predicted: BoardDetection) -> BoardDetection | None:
        return self._at(frame.grey, predicted.corners_px.reshape(-1, 4, 2), _MAX_TRACKED_MOVE)

    def _search(
        self, image: Image, methods: Iterable[int], region: Region | None = None
    ) -> list[BoardDetection]:
        """Search the image, or a region of it, by some methods until one suffices."""
        part = cut_out(image, region)
        board, count = self.target, self.target.columns * self.target.rows
        sufficient = _SUFFICIENT_FRACTION * 4 * count
        best: BoardDetection | None = None
        most, exceeded = 0, False
        for method_index in methods:
            squares = find_grid_tags(part.image, method_index)
            placed = _largest_group(squares, board.columns, board.spacing)
            beyond = [each.id >= count for each in placed]
            # arranged as on a board of as many columns but more rows
            exceeded |= any(beyond) and not all(beyond)
            own = sum(each.id < count for each in squares)
            # else it is another layout, or a part of a larger board
            if len(placed) >= max(_LEAST_OWN_ARRANGED_FRACTION * own, 1) and not any(beyond):
                found = self._at(image, _tags_of(placed, count) + part.corner)
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

    def _at(self, image: Image, tags: Tags, step: float | None = None) -> BoardDetection | None:
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
        known = np.flatnonzero(search.known)
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
        sigmas[known] = np.maximum(search.sigmas(known, own), grid_sigma_px)
        middle = cv2.perspectiveTransform(np.zeros((1, 1, 2)), fit.homography)[0, 0]
        sigma = origin_sigma_px(fit.homography, board_m, sigmas[known])
        if (board_m.min(axis=0) < 0).all() and (board_m.max(axis=0) > 0).all():
            middle = middle + fit.origin_distortion_px
            sigma = np.hypot(sigma, fit.origin_distortion_sigma_px)
        point = flat.to_pixels(middle[None])[0]
        return BoardDetection(board, point, out, sigma, sigmas, camera=self.camera)


_OTHER_GRID_METHODS: Final = (1, 3)
"""Search methods that are tried for other boards (numerical: indices)."""
_LEAST_OTHER_TAGS: Final = 3
"""Least number of tags of a board (chosen)."""
_SPACING_STEP: Final = 0.01
"""Resolution of estimated spacings (chosen: spacings are round numbers)."""


def alternative_grids(image: Image, missed_grid: AprilGrid | None) -> Iterator[AprilGrid]:
    """Boards other than the one that was not found, or any, that explain the tags in an image.

    They have the number of columns that most tags agree with, as many rows as the tags need, the
    estimated spacing, and the edge of the missed board's tags.
    """
    asked = missed_grid or AprilGrid()
    for method_index in _OTHER_GRID_METHODS:
        found = find_grid_tags(image, method_index)
        spacing = _spacing(found, asked)
        groups = [
            (_largest_group(found, columns, spacing), columns)
            for columns in alternative_columns(asked, 1)
        ]
        best, columns = max(groups, key=lambda each: len(each[0]))
        if len(best) < max(_LEAST_OTHER_TAGS, LEAST_ARRANGED_FRACTION * len(found)):
            continue
        rows = 1 + max(each.id for each in best) // columns
        if missed_grid is not None and columns == missed_grid.columns:
            rows = max(rows, missed_grid.rows)
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
