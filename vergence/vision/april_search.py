"""Search for an AprilGrid's corners from its first tags, and check their smoothness."""

from dataclasses import replace
from functools import lru_cache
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.vision.charuco import grey_at_pixels
from vergence.vision.corners import (
    corner_sigmas,
    estimate_noise_grey,
    refine_corners,
    remaining_move_px,
)
from vergence.vision.optics import FlatView, IdentityView, fit_homography
from vergence.vision.tag_families import GRID_BORDER_BITS, AprilGrid

_WINDOW_FRACTION: Final = 0.6
"""Half side of the refinement window, as a fraction of the distance to the next edge (chosen: more
pixels against disturbance by that edge)."""
_WINDOW_PX: Final = (2, 5)
"""Range of the half side of the refinement window, px (chosen)."""
_MAX_REMAINING_MOVE_PX: Final = 0.5
"""Largest remaining move of a corner that counts as refined, px (chosen)."""
_PROBE_FRACTION: Final = 0.45
"""Distance of grey samples from a corner along both axes, as a fraction of the distance to the next
edge (chosen)."""
_LEAST_CONTRAST_GREY: Final = 5.0
"""Least contrast at a corner, grey levels (chosen: above noise)."""
_LEAST_RELATIVE_CONTRAST: Final = 0.25
"""Least contrast at a corner, as a fraction of the median of all corners (chosen)."""
_LEAST_CORRELATION: Final = 0.6
"""Least correlation of a tag's bits with its print; another tag has at most 0.4 (chosen)."""
_LEAST_OTHER_CORRELATION: Final = 0.7
"""Least correlation of a tag's bits with any print of the family; noise reaches it at one place in
100 (chosen)."""
_LEAST_OTHER_CORNERS: Final = 2
"""Least corners of a tag, found on the board's grid, that may show another board (chosen)."""
_TAG_BITS: Final = len(AprilGrid().tag_bits(0))
"""Bits along a tag's edge (physical: Kalibr's boards)."""
_MAX_PREDICTING_CORNERS: Final = 12
"""Most corners that predict a neighbouring tag (chosen: averaging against lens distortion)."""
_UNIT_SQUARE: Final = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
"""Corners of a tag in units of its edge (numerical)."""

Tags = NDArray[np.float64]
"""Corners of tags, px, shape (tags, 4, 2); nan for unknown ones."""


def known_corner_mask(tags: Tags) -> NDArray[np.bool_]:
    """Mask of the known corners, (tags, 4)."""
    return np.asarray(np.isfinite(tags).all(axis=-1), np.bool_)


class CornerSearch:
    """State of a search for the corners of a board in an image.

    Attributes:
        found: corners of all tags that have been found, nan for others.
        predicted: predicted corners of the tags that have been tried.
    """

    def __init__(
        self, image: NDArray[np.uint8], board: AprilGrid, flat: FlatView | IdentityView
    ) -> None:
        count = board.columns * board.rows
        self.found: Tags = np.full((count, 4, 2), np.nan)
        self.predicted: Tags = np.full((count, 4, 2), np.nan)
        self._image = image
        self._board = board
        self._flat = flat
        self._contrast = np.nan
        self._free = min(board.spacing, 2.0 * board.bit_m / board.tag_m)
        """Distance from a corner to the next edge, as a ratio to a tag's edge."""
        self._half_sides_px = np.zeros(count, int)
        self._corners_m = board.corners_m.reshape(-1, 4, 2)

    def refine_corners_of(
        self,
        corner_mask: NDArray[np.bool_],
        predicted: Tags,
        max_move_fraction: float | None = None,
    ) -> None:
        """Refine corners, and drop those without the printed contrast.

        Args:
            corner_mask: (tags, 4) mask of the corners to refine.
            predicted: predicted corners of their tags, all four of each.
            max_move_fraction: largest move of a corner as a fraction of the distance to the next
                edge; None for the reach of the window.
        """
        numbers, own = np.nonzero(corner_mask)
        if not len(numbers):
            return
        self.predicted[corner_mask] = predicted[corner_mask]
        height, width = self._image.shape
        lengths = np.linalg.norm(predicted - np.roll(predicted, 1, axis=1), axis=-1)[numbers]
        free = self._free * np.nan_to_num(np.nanmin(lengths, axis=1))
        half_sides_px = np.clip(np.rint(_WINDOW_FRACTION * free), *_WINDOW_PX).astype(int)
        self._half_sides_px[numbers] = half_sides_px
        start = predicted[corner_mask]
        places = np.full(start.shape, np.nan)
        end = np.array([width - 1.0, height - 1.0])
        inside = ((start > 0.0) & (start < end)).all(axis=1)
        for half_side_px in np.unique(half_sides_px[inside]).tolist():
            chosen = np.flatnonzero(inside & (half_sides_px == half_side_px))
            refined = refine_corners(self._image, start[chosen], half_side_px)
            moved = np.abs(refined - start[chosen]).max(axis=1)
            most = (
                half_side_px + 1.0
                if max_move_fraction is None
                else np.maximum(max_move_fraction * free[chosen], 1.0)
            )
            good = (moved <= most) & (
                remaining_move_px(self._image, refined, half_side_px) <= _MAX_REMAINING_MOVE_PX
            )
            good &= ((refined > 0.0) & (refined < end)).all(axis=1)
            places[chosen[good]] = refined[good]
        self.found[numbers, own] = places
        tags = np.unique(numbers)
        contrast = np.full(corner_mask.shape, np.nan)
        contrast[tags] = self._alternation(tags)
        seen = contrast[corner_mask & np.isfinite(contrast)]
        if np.isnan(self._contrast) and len(seen):
            self._contrast = max(
                _LEAST_RELATIVE_CONTRAST * float(np.median(seen)), _LEAST_CONTRAST_GREY
            )
        plain = np.asarray(corner_mask & ~(contrast > self._contrast))
        self.found[plain] = np.nan

    def find_neighbouring_tags(self) -> None:
        """Search for tags next to those found, repeatedly outwards."""
        tried = np.asarray(known_corner_mask(self.found).any(axis=1), np.bool_)
        while True:
            new = self.refine_neighbours_of_whole_tags(tried)
            if not len(new):
                break
            tried[new] = True
            seen = new[np.isfinite(self.predicted[new]).all(axis=(1, 2))]
            self.found[np.setdiff1d(new, seen[self.tags_matching_print(seen)])] = np.nan
        there = known_corner_mask(self.found)
        self._refine_beside(np.flatnonzero(there.any(axis=1) & ~there.all(axis=1)), np.inf)

    def refine_neighbours_of_whole_tags(self, tried: NDArray[np.bool_]) -> NDArray[np.intp]:
        """Refine the corners of tags next to complete ones, except some; return their numbers."""
        places, whole = self._board.tag_cells, known_corner_mask(self.found).all(axis=1)
        apart = np.abs(places[:, None] - places).max(axis=-1)
        new = np.flatnonzero(~tried & ((apart <= 1) & whole).any(axis=1))
        # the near corners first, since a lens distorts less over a gap than over a tag
        self._refine_beside(new, 1.01 * self._board.spacing * self._board.tag_m)
        self._refine_beside(new, np.inf)
        return new

    def _refine_beside(self, numbers: NDArray[np.intp], most_m: float) -> None:
        """Refine missing corners of some tags, predicted from the corners around them.

        Args:
            numbers: numbers of the tags.
            most_m: largest distance on the board to the nearest known corner, m.
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

    def half_gaps_px(self) -> NDArray[np.float64]:
        """Half the gap between tags in the image at each tag, (tags,) px."""
        edges = self.predicted - np.roll(self.predicted, 1, axis=1)
        return np.asarray(0.5 * self._board.spacing * np.linalg.norm(edges, axis=-1).min(axis=1))

    def tags_matching_print(self, tag_numbers: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Mask of the tags whose image agrees with their print."""
        if not len(tag_numbers):
            return np.zeros(0, bool)
        alike = (self._codes(tag_numbers) * _printed_codes()[tag_numbers]).sum(axis=1)
        return np.asarray(alike > _LEAST_CORRELATION)

    def read_numbers(self, tag_numbers: NDArray[np.intp]) -> NDArray[np.intp]:
        """Numbers that the image shows at some tags of the board, -1 where none can be read."""
        alike = self._codes(tag_numbers) @ _printed_codes().T
        return np.where(alike.max(axis=1) > _LEAST_OTHER_CORRELATION, alike.argmax(axis=1), -1)

    def _codes(self, tag_numbers: NDArray[np.intp]) -> NDArray[np.float64]:
        """Grey levels of tags' codes, as `_printed_codes`."""
        middles = (np.arange(GRID_BORDER_BITS, _TAG_BITS - GRID_BORDER_BITS) + 0.5) / _TAG_BITS
        cells = np.stack(np.meshgrid(middles, middles), axis=-1).reshape(-1, 2)
        return _normalised(self._grey(tag_numbers, cells))

    def sigmas(
        self,
        corner_indices: NDArray[np.intp],
        corners: NDArray[np.float64],
        tag_numbers: NDArray[np.intp],
    ) -> NDArray[np.float64]:
        """Standard deviations of corners due to pixel noise, (n, 2) px.

        Args:
            corner_indices: (n,) indices of the corners.
            corners: (n, 2) their pixels, px.
            tag_numbers: numbers of the tags that they belong to.
        """
        half = 0.5 * self._board.spacing
        gaps = np.array([[0.5, -half], [1.0 + half, 0.5], [0.5, 1.0 + half], [-half, 0.5]])
        noise = estimate_noise_grey(self._image, self._seen(tag_numbers, gaps).reshape(-1, 2))
        half_sides_px = self._half_sides_px[corner_indices // 4]
        out = np.empty(corners.shape)
        for half_side_px in np.unique(half_sides_px).tolist():
            own = half_sides_px == half_side_px
            out[own] = corner_sigmas(self._image, corners[own], half_side_px, noise)
        return out

    def _alternation(self, numbers: NDArray[np.intp]) -> NDArray[np.float64]:
        """Contrast of white to black around each corner, (tags, 4) grey levels."""
        away = _PROBE_FRACTION * self._free
        steps = away * np.array([[-1.0, -1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, 1.0]])
        grey = self._grey(numbers, (_UNIT_SQUARE[:, None] + steps).reshape(-1, 2)).reshape(-1, 4, 4)
        falling = 0.5 * (grey[..., 2] + grey[..., 3] - grey[..., 0] - grey[..., 1])
        contrast = falling * np.array([1.0, -1.0, 1.0, -1.0])
        missing = ~known_corner_mask(self.found[numbers])
        contrast[missing] = np.nan
        return np.asarray(contrast)

    def _grey(self, numbers: NDArray[np.intp], places: NDArray[np.float64]) -> NDArray[np.float64]:
        """Grey levels at positions on tags, in units of their edges, shape (tags, n)."""
        seen = self._seen(numbers, places)
        return grey_at_pixels(self._image, seen.reshape(-1, 2)).reshape(seen.shape[:2])

    def _seen(self, numbers: NDArray[np.intp], places: NDArray[np.float64]) -> NDArray[np.float64]:
        """Pixels of positions on tags, in units of their edges, shape (tags, n, 2)."""
        out = np.empty((len(numbers), len(places), 2))
        for i, number in enumerate(numbers.tolist()):
            refined = np.isfinite(self.found[number])
            corners = np.where(refined, self.found[number], self.predicted[number])
            transform = cv2.getPerspectiveTransform(
                _UNIT_SQUARE.astype(np.float32), corners.astype(np.float32)
            )
            out[i] = cv2.perspectiveTransform(places[None], transform)[0]
        return out


def count_other_tags(
    image: NDArray[np.uint8], board: AprilGrid, flat: FlatView | IdentityView, tags: Tags
) -> int:
    """Count tags next to found ones, on a board's grid, where the board has another tag or none.

    Args:
        image: grey levels, shape (height, width).
        board: the board.
        flat: undistorted plane around the tags.
        tags: corners of the tags that are found.
    """
    columns = board.columns + 2
    if columns * (board.rows + 2) > len(board.code.code_words):
        return 0
    around = replace(board, columns=columns, rows=board.rows + 2)
    # the board in the middle of this one
    numbers = np.full((board.rows + 2, columns), -1)
    numbers[1:-1, 1:-1] = np.arange(len(tags)).reshape(board.rows, board.columns)
    inner = np.flatnonzero(numbers >= 0)
    search = CornerSearch(image, around, flat)
    placed = np.full(search.found.shape, np.nan)
    placed[inner] = tags
    whole = np.asarray(known_corner_mask(placed).all(axis=1), np.bool_)
    search.refine_corners_of(np.repeat(whole[:, None], 4, axis=1), placed)
    beside = search.refine_neighbours_of_whole_tags(whole)
    seen = beside[known_corner_mask(search.found[beside]).sum(axis=1) >= _LEAST_OTHER_CORNERS]
    read = search.read_numbers(seen)
    return int(((read >= 0) & (read != numbers.ravel()[seen])).sum())


def _normalised(levels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Levels of each row, without their mean, as a vector of length 1."""
    levels = levels - levels.mean(axis=1, keepdims=True)
    return np.asarray(levels / np.maximum(np.linalg.norm(levels, axis=1, keepdims=True), 1e-6))


@lru_cache(maxsize=1)
def _printed_codes() -> NDArray[np.float64]:
    """Codes of all tags of the family, row by row, normalised, shape (tags, bits)."""
    board = AprilGrid()
    code = slice(GRID_BORDER_BITS, _TAG_BITS - GRID_BORDER_BITS)  # borders are equal in all tags
    every = [
        board.tag_bits(number)[code, code].ravel() for number in range(len(board.code.code_words))
    ]
    return _normalised(np.array(every, float))


_MAX_DISTORTION_DEGREE: Final = 8
"""Highest degree of the polynomial that models lens distortion on top of a homography (chosen)."""
_COARSE_DEGREE: Final = 3
"""Highest degree in the first fit, which finds corners mistaken for others (chosen)."""
_CORNERS_PER_COEFFICIENT: Final = 2.0
"""Least number of corners per coefficient of that polynomial (chosen: avoids overfitting)."""
_HOMOGRAPHY_PARAMETERS: Final = 4
"""Parameters of a homography per image coordinate (numerical)."""

# Residual of a corner from the fit above which it is an outlier; it exceeds both (chosen).
_STRAY_PX: Final = 0.2
_STRAY_SIGMAS: Final = 6.0  # standard deviations

_MOST_ROUNDS: Final = 8
"""Most rounds of removing outliers (numerical)."""


class SmoothHomographyFit(NamedTuple):
    """Homography of a board plus a smooth lens distortion, fitted to its corners."""

    homography: NDArray[np.float64]
    """Homography from the board's plane to the image."""
    inliers: NDArray[np.bool_]
    """(n,) mask of the inliers."""
    residual_sigma_px: float
    """Standard deviation of the inliers' residuals, of each coordinate; 0 if unknown."""
    origin_distortion_px: NDArray[np.float64]
    """(2,) lens distortion at the board's origin, added to the homography."""
    origin_distortion_sigma_px: float
    """Standard deviation of each coordinate of `origin_distortion_px`."""


def fit_smooth_homography(
    board_m: NDArray[np.float64], pixels: NDArray[np.float64], max_residual_px: NDArray[np.float64]
) -> SmoothHomographyFit | None:
    """Fit a homography and a smooth distortion to corners, without outliers.

    Args:
        board_m: (n, 2) corners on the board, m.
        pixels: (n, 2) these corners in the image, or in an undistorted plane, px.
        max_residual_px: (n,) largest residual of each from a coarse fit, px: less than the
            distance to another corner.

    Returns:
        The fit; None if the corners are collinear, or fewer than four are left.
    """
    good = np.ones(len(pixels), bool)
    fit: _Fit | None = None
    for highest, most_px in ((_COARSE_DEGREE, max_residual_px), (_MAX_DISTORTION_DEGREE, None)):
        for _ in range(_MOST_ROUNDS):
            fit = _fit_polynomial(board_m, pixels, good, highest)
            if fit is None:
                return None
            fine = max(_STRAY_PX, _STRAY_SIGMAS * fit.robust_px)
            over = fit.residual_px / (fine if most_px is None else most_px[good])
            if not fit.overdetermined or over.max() <= 1.0:
                break
            # an outlier also pulls its neighbours away, so only the worst are removed per round
            good[np.flatnonzero(good)[over > max(1.0, 0.5 * float(over.max()))]] = False
    assert fit is not None
    return SmoothHomographyFit(
        fit.homography, good, fit.residual_sigma_px, fit.distortion_px, fit.distortion_sigma_px
    )


class _Fit(NamedTuple):
    homography: NDArray[np.float64]
    residual_px: NDArray[np.float64]
    """(n,) residual of each corner from its prediction by the others."""
    robust_px: float
    """Standard deviation of the residuals, estimated by their median."""
    residual_sigma_px: float
    distortion_px: NDArray[np.float64]
    distortion_sigma_px: float
    overdetermined: bool
    """True if there are more corners than coefficients, so that residuals carry evidence."""


def _fit_polynomial(
    board_m: NDArray[np.float64],
    pixels: NDArray[np.float64],
    good: NDArray[np.bool_],
    highest: int,
) -> _Fit | None:
    """Fit the polynomial with least generalised cross validation (Golub, Heath and Wahba 1979)."""
    count = int(good.sum())
    transform = (
        fit_homography(board_m[good], pixels[good]) if count >= _HOMOGRAPHY_PARAMETERS else None
    )
    if transform is None:
        return None
    residuals = (pixels - cv2.perspectiveTransform(board_m[None], transform)[0])[good]
    terms, ends = _terms(board_m[good] / np.abs(board_m).max(), highest)
    basis = np.linalg.qr(terms)[0]
    shares = basis.T @ residuals
    spent = np.array([0, *ends]) + _HOMOGRAPHY_PARAMETERS
    explained = np.concatenate([[0.0], np.cumsum((shares**2).sum(axis=1))[ends - 1]])
    unexplained = np.maximum((residuals**2).sum() - explained, 0.0)
    free = np.maximum(count - spent, 1e-9)
    best = int(np.argmin(unexplained / free**2))
    used = int(spent[best]) - _HOMOGRAPHY_PARAMETERS
    overdetermined = bool(free[best] >= 1)
    sigma = float(np.sqrt(unexplained[best] / (2.0 * free[best]))) if overdetermined else 0.0
    # all terms but the constant vanish at the origin
    weights = np.linalg.pinv(terms[:, :used])[0] if used else np.zeros(count)
    remaining = residuals - basis[:, :used] @ shares[:used]
    own = 1.0 - (basis[:, :used] ** 2).sum(axis=1) - _HOMOGRAPHY_PARAMETERS / count
    return _Fit(
        transform,
        np.abs(remaining / np.maximum(own, 0.1)[:, None]).max(axis=1),
        1.48 * float(np.median(np.abs(remaining))),
        sigma,
        weights @ residuals,
        sigma * float(np.linalg.norm(weights)),
        overdetermined,
    )


def _terms(
    places: NDArray[np.float64], highest: int
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Monomials at positions in -1..1, (n, p), lower degrees first; cumulative count by degree."""
    x, y = places.T
    columns, rows = (len(np.unique(np.rint(1e6 * each))) for each in (x, y))
    terms: list[NDArray[np.float64]] = []
    ends: list[int] = []
    for degree in range(highest + 1):
        more = [x**i * y ** (degree - i) for i in range(degree + 1)
                if i < columns and degree - i < rows]  # fmt: skip
        if degree > 0 and _CORNERS_PER_COEFFICIENT * (
            len(terms) + len(more)
        ) + _HOMOGRAPHY_PARAMETERS > len(x):
            break
        terms += more
        ends.append(len(terms))
    return np.stack(terms, axis=1), np.array(ends)
