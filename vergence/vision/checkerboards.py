"""Detection of checkerboards: OpenCV's search, in clusters of corners first, and refinement."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.models.parts import FloatArray
from vergence.vision.corners import (
    MAX_TRACKED_MOVE_SQUARES,
    WINDOW_FRACTION,
    WINDOW_PX,
    Grid,
    corner_scatter_px,
    crossing_asymmetries,
    in_image,
    is_even_unmirrored_grid,
    loo_residuals_and_scales,
    pixel_noise_grey,
    refine_and_check,
    refine_corners,
    refine_corners_robustly,
    shortest_square_edge_px,
    square_centres,
    unit_sigmas,
    window_half_side_px,
)
from vergence.vision.detection import BoardDetection, BoardDetector, Frame, Region, cut_out
from vergence.vision.image import smooth_for_square_search
from vergence.vision.optics import FlatView, Image
from vergence.vision.prints import board_continues_beyond, squares_alternate
from vergence.vision.targets import Checkerboard

_BLUR_PX: Final = 1.2
"""Standard deviation of the smoothing before derivatives, px (chosen: noise against small
squares)."""
_SADDLE_WINDOW_PX: Final = 5
"""Side of the square in which only the strongest saddle is kept, px (chosen)."""
_LEAST_SADDLE_STRENGTH: Final = 1.5
"""Least strength of a saddle: minus the determinant of the Hessian, (grey levels / px^2)^2
(chosen)."""
_MOST_SADDLES: Final = 4000
"""Most saddles that are kept, the strongest (chosen: time)."""
_CIRCLE_RADIUS_PX: Final = 4.0
"""Radius of the circle of samples around a saddle, px (chosen: inside the smallest squares)."""
_CIRCLE_SAMPLES: Final = 16
"""Samples on the circle (numerical)."""
_LEAST_RANGE_GREY: Final = 6
"""Least range of the samples on the circle, grey levels (chosen: above noise)."""
_LEAST_CROSS_RATIO: Final = 1.5
"""Least ratio of the contrast between crossed pairs of quadrants to that between opposite sides,
which is 0 at an ideal corner (chosen)."""
_NEIGHBOUR_COUNT: Final = 8
"""Number of nearest saddles that are considered as neighbours (chosen)."""
_MAX_AXIS_COSINE: Final = -0.5
"""Largest cosine of twice the angle between the light axes of neighbours; -1 if perpendicular
(chosen)."""
_MAX_EDGE_AXIS_COSINE: Final = 0.8
"""Largest absolute cosine of twice the angle between a light axis and the edge; 0 at 45 degrees
(chosen)."""
_EDGE_SAMPLE_FRACTIONS: Final = (0.3, 0.5, 0.7)
"""Positions of the samples along an edge, as fractions of its length (chosen)."""
_EDGE_SAMPLE_OFFSET: Final = 0.2
"""Distance of the samples from an edge, as a fraction of its length (chosen)."""
_LEAST_SAMPLE_OFFSET_PX: Final = 1.5
"""Least distance of the samples from an edge, px (chosen)."""
_LEAST_EDGE_CONTRAST: Final = 0.25
"""Least contrast across an edge, as a fraction of the range on the circles at its ends (chosen)."""
_LEAST_RANGE_RATIO: Final = 0.4
"""Least ratio of the smaller to the larger range on the circles of neighbours (chosen)."""
_LEAST_SIZE_RATIO: Final = 0.7
"""Least size of a cluster, as a fraction of the board's corners (chosen)."""
_MAX_SIZE_RATIO: Final = 4.0
"""Largest size of a cluster, as a ratio to the board's corners (chosen: tiled floors have more)."""
_MOST_CLUSTERS: Final = 3
"""Most clusters that are returned (chosen: search time)."""
_MARGIN_EDGES: Final = 2.0
"""Margin around a cluster in lengths of its edges, for the outermost squares and the light rim
(chosen)."""
_MARGIN_PX: Final = 6.0
"""Additional margin around a cluster, px (chosen)."""


def find_corner_clusters(image: Image, board_corner_count: int) -> list[tuple[Region, FloatArray]]:
    """Find clusters, in an image without much noise, of about as many corners as a board has.

    For a few, the nearest in size first: the region of a board that they may belong to, and the
    corners, (n, 2) to one pixel.
    """
    smooth = np.asarray(cv2.GaussianBlur(image, (0, 0), _BLUR_PX), np.uint8)
    found, hessians, ranges = _corners(smooth)
    count = len(found)
    if count < _LEAST_SIZE_RATIO * board_corner_count:
        return []
    first, second = _of_squares(count, *_edges(smooth, found, hessians, ranges))
    # imported here so that commands that seek no board start sooner
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    links = coo_array((np.ones(len(first)), (first, second)), shape=(count, count))
    _number, cluster = connected_components(links, directed=False)
    sizes = np.bincount(cluster)
    alike = np.flatnonzero(
        (sizes >= _LEAST_SIZE_RATIO * board_corner_count)
        & (sizes <= _MAX_SIZE_RATIO * board_corner_count)
    )
    lengths = np.linalg.norm(found[first] - found[second], axis=1)
    out = []
    nearest = np.argsort(np.abs(sizes[alike] - board_corner_count), kind="stable")
    for k in alike[nearest][:_MOST_CLUSTERS]:
        places = found[cluster == k]
        margin = _MARGIN_EDGES * float(np.median(lengths[cluster[first] == k])) + _MARGIN_PX
        low = np.floor(np.maximum(places.min(axis=0) - margin, 0))
        high = np.ceil(np.minimum(places.max(axis=0) + margin + 1, image.shape[::-1]))
        x0, y0, x1, y1 = (int(each) for each in (*low, *high))
        out.append(((x0, y0, x1, y1), places.astype(float)))
    return out


def _corners(smooth: Image) -> tuple[NDArray[np.int64], FloatArray, NDArray[np.int16]]:
    """Find the strongest saddles of the grey levels, with four changes of light and dark around.

    Their places, (n, 2) px; d2/du2, d2/dudv, d2/dv2, (n, 3); the range on each one's circle, (n,).
    """
    second: Any = [
        cv2.Sobel(smooth, cv2.CV_32F, *orders, ksize=3, scale=0.25)
        for orders in ((2, 0), (1, 1), (0, 2))
    ]
    uu, uv, vv = second
    strength = uv * uv - uu * vv
    around = cv2.dilate(strength, np.ones((_SADDLE_WINDOW_PX, _SADDLE_WINDOW_PX), np.uint8))
    v, u = np.nonzero((strength >= around) & (strength > _LEAST_SADDLE_STRENGTH))
    if len(u) > _MOST_SADDLES:
        strongest = np.argpartition(strength[v, u], -_MOST_SADDLES)[-_MOST_SADDLES:]
        u, v = u[strongest], v[strongest]
    places = np.stack([u, v], axis=1)
    angles = 2.0 * np.pi * np.arange(_CIRCLE_SAMPLES) / _CIRCLE_SAMPLES
    circle = np.rint(_CIRCLE_RADIUS_PX * np.column_stack([np.cos(angles), np.sin(angles)]))
    greys = _greys_at(smooth, places[:, None] + circle)
    high, low = greys.max(axis=1), greys.min(axis=1)
    light = 2 * greys > (high + low)[:, None]
    changes = (light != np.roll(light, 1, axis=1)).sum(axis=1)
    first, second, third, fourth = np.split(greys, 4, axis=1)  # by quadrants
    crossed = np.abs(first + third - second - fourth).sum(axis=1)
    opposite = np.abs(np.hstack([first - third, second - fourth])).sum(axis=1)
    ranges = high - low
    kept = (changes == 4) & (ranges > _LEAST_RANGE_GREY) & (crossed > _LEAST_CROSS_RATIO * opposite)
    numbers = np.flatnonzero(kept)
    from scipy.spatial import cKDTree

    # a corner midway between pixels is equally strong in all of them
    same = cKDTree(places[numbers]).query_pairs(0.5 * _SADDLE_WINDOW_PX, output_type="ndarray")
    numbers = np.delete(numbers, same[:, 1])
    (u, v), ranges = places[numbers].T, ranges[numbers]
    hessians = np.stack([uu[v, u], uv[v, u], vv[v, u]], axis=1).astype(float)
    return places[numbers], hessians, ranges


def _edges(
    smooth: Image, places: NDArray[np.int64], hessians: FloatArray, ranges: NDArray[np.int16]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pairs of corners with an edge between them, as (m,) indices of the first and the second."""
    from scipy.spatial import cKDTree

    uu, uv, vv = hessians.T
    near = min(_NEIGHBOUR_COUNT + 1, len(places))
    _distances, found = cKDTree(places).query(places, k=near)
    first = np.repeat(np.arange(len(places)), near - 1)
    second = np.reshape(found, (len(places), near))[:, 1:].ravel()
    axis = np.arctan2(2.0 * uv, uu - vv)  # twice the angle of the light axis
    along = places[second] - places[first]
    edge = 2.0 * np.arctan2(along[:, 1], along[:, 0])
    kept = np.cos(axis[first] - axis[second]) < _MAX_AXIS_COSINE
    kept &= np.abs(np.cos(edge - axis[first])) < _MAX_EDGE_AXIS_COSINE
    least, most = np.sort([ranges[first], ranges[second]], axis=0)
    kept &= least > _LEAST_RANGE_RATIO * most
    first, second, along, most = first[kept], second[kept], along[kept], most[kept]
    length = np.linalg.norm(along, axis=1, keepdims=True)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1) / length
    # the sign of the mixed derivative along and across the edge gives its light side
    bend = along[:, 0] * (uu[first] * across[:, 0] + uv[first] * across[:, 1])
    bend += along[:, 1] * (uv[first] * across[:, 0] + vv[first] * across[:, 1])
    away = np.maximum(_EDGE_SAMPLE_OFFSET * length, _LEAST_SAMPLE_OFFSET_PX)
    aside = np.sign(bend)[:, None] * across * away
    kept = np.ones(len(first), np.bool_)
    for share in _EDGE_SAMPLE_FRACTIONS:
        middle = places[first] + share * along
        step = _greys_at(smooth, middle + aside) - _greys_at(smooth, middle - aside)
        kept &= step > _LEAST_EDGE_CONTRAST * most
    return first[kept], second[kept]


def _of_squares(
    count: int, first: NDArray[np.int64], second: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Select edges, see `_edges`, that close to a square by three more edges."""
    from scipy.sparse import csr_array

    either = np.concatenate([first, second]), np.concatenate([second, first])
    edges = csr_array((np.ones(2 * len(first), np.int32), either), shape=(count, count))
    edges.data[:] = 1
    # two corners with two common neighbours are opposite in a square
    opposite = edges @ edges
    opposite.setdiag(0)
    opposite.data = (opposite.data > 1).astype(np.int32)
    sides = edges.multiply(opposite @ edges).tocoo()
    kept = sides.data > 0
    return sides.row[kept].astype(np.int64), sides.col[kept].astype(np.int64)


def _greys_at(image: Image, places: NDArray[Any]) -> NDArray[np.int16]:
    """Grey levels of the nearest pixels, shape (...) for (..., 2)."""
    height, width = image.shape
    u, v = np.moveaxis(np.rint(places).astype(int), -1, 0)
    inside = image[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)]
    return np.asarray(inside, np.int16)


_LARGE_WINDOW_SQUARES: Final = 0.25
"""Largest half side of the refinement window for large squares, in squares (chosen: out of focus
their edges are wider than 11 px, and in such a window corners would be off by a pixel)."""
_LARGE_WINDOW_PX: Final = 24
"""Largest half side of that window for large squares, px (chosen)."""
_LEAST_SQUARE_PX: Final = 2.5
"""Shortest edge of a square that is read, px (chosen)."""

# Largest standard deviation of corners about a smooth grid; above both, the image is smeared beyond
# use or shows no board (chosen).
_MAX_SCATTER_SQUARES: Final = 0.1  # in squares
_MAX_SCATTER_PX: Final = 1.0

# Residual of a corner from the prediction by all others above which it is a stray; it exceeds both
# (chosen: more than noise).
_STRAY_PX: Final = 0.15
_STRAY_RATIO: Final = 4.0  # ratio to the median residual

_MAX_STRAY_FRACTION: Final = 0.25
"""Largest fraction of corners not refined, such as those at the edge of a shadow (chosen)."""
_MAX_STRAY_ROUNDS: Final = 3
"""Most rounds of refining stray corners again (numerical)."""

# Half side of the window in which a stray corner is refined by the edges that meet at it (chosen).
_STRAY_WINDOW_SQUARES: Final = 0.45  # in squares
_STRAY_WINDOW_PX: Final = (2, 12)  # its range

# Residual of a corner that is not where squares meet, so that the board is refused; it exceeds all
# three (chosen).
_FATAL_RESIDUAL_PX: Final = 0.5
_FATAL_RESIDUAL_SQUARES: Final = 0.07  # in squares
_FATAL_RESIDUAL_RATIO: Final = 7.0  # ratio to the median residual

_CROSSING_SQUARES: Final = 0.4
"""Half side of the window in which edges have to cross, in squares (chosen)."""
_CROSSING_PX: Final = (2, 10)
"""Range of that half side, px (chosen)."""
_MAX_ASYMMETRY: Final = 1.0
"""Asymmetry of a corner from which on it is mistaken, see `crossing_asymmetries` (chosen: wrong
ones have 1.3 or more, and those of public photographs up to 0.4)."""
_CLEAR_ASYMMETRY: Final = 0.1
"""Asymmetry up to which edges clearly cross at a corner, so that it is no stray even if a strongly
distorting lens puts it far from its prediction (measured: 99 % in public photographs)."""

_PREDICTION_ERROR_SQUARES: Final = 0.4
"""Prediction error of a tracked target that the second attempt allows for, in squares (chosen)."""
_CORRECTED_ERROR_SQUARES: Final = (0.2, 0.7)
"""Range of the errors of OpenCV's corners that are corrected where squares run together, in squares
(chosen)."""
_SQUARE_SEARCH_SIDE_PX: Final = 1600
"""Longer side to which larger images are reduced for the search for squares, px (chosen: time
against small squares)."""
_CLUSTER_SEARCH_SIDES_PX: Final = (640, 320, _SQUARE_SEARCH_SIDE_PX)
"""Longer sides to which larger images are reduced for the search for clusters of corners: most
boards are found at the first, blurred ones at the second, small squares at the last (chosen)."""
_SIDES_IN_TURN_PX: Final = (640, _SQUARE_SEARCH_SIDE_PX, 640, 320)
"""Longer sides in turn, one per image, if a single search method is asked for (chosen)."""


_Search = Callable[[Image, tuple[int, int]], tuple[bool, Any]]
"""Search of OpenCV for a board of (columns, rows) corners: true if all are found, and them."""
# Not OpenCV's other two defaults: equalising the histogram of a board before a plain background
# raises the noise, and the fast check misses boards of 100 px.
_BY_SQUARES: Final[_Search] = partial(cv2.findChessboardCorners, flags=cv2.CALIB_CB_ADAPTIVE_THRESH)
_BY_EQUALISED_SQUARES: Final[_Search] = partial(
    cv2.findChessboardCorners, flags=cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
)
_BY_SECTORS: Final[_Search] = partial(
    cv2.findChessboardCornersSB, flags=cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE
)


class CheckerboardDetector(BoardDetector[Checkerboard]):
    """Detects a checkerboard; the measured point is its upper right corner, or its centre.

    The centre is measured on boards that look equal after a rotation by 180 degrees. The corners of
    such a board, or of one equal after 90 degrees, come in the possible order whose first row
    points most to the right.
    """

    def _detect_some(self, frame: Frame, way: int | None = None) -> list[BoardDetection]:
        """Search clusters of corners in the image at one size after another."""
        sides_px: tuple[int, ...] = _CLUSTER_SEARCH_SIDES_PX
        if way is not None:
            sides_px = (_SIDES_IN_TURN_PX[way % len(_SIDES_IN_TURN_PX)],)
        for most_px in sides_px:
            part = cut_out(frame.grey, most_px=most_px)
            calm = smooth_for_square_search(part.image)
            if calm is None:
                continue
            for region, corners in find_corner_clusters(calm, len(self.target.corners_m)):
                x0, y0 = (math.floor(value / part.scale) for value in region[:2])
                x1, y1 = (math.ceil(value / part.scale) for value in region[2:])
                if found := self._search(frame.grey, (x0, y0, x1, y1), part.in_whole(corners)):
                    return found
        return []

    def _detect_all(self, frame: Frame) -> list[BoardDetection]:
        methods = (_BY_SQUARES, _BY_EQUALISED_SQUARES, _BY_SECTORS)
        return self._search(frame.grey, methods=methods)

    def _detect_in(
        self, frame: Frame, region: Region, predicted: BoardDetection
    ) -> list[BoardDetection]:
        return self._search(frame.grey, region)

    def _search(
        self,
        image: Image,
        region: Region | None = None,
        near: FloatArray | None = None,
        methods: tuple[_Search, ...] = (_BY_SQUARES,),
    ) -> list[BoardDetection]:
        """Search an image, or a region of it, by some methods until one finds the board.

        Where squares run into each other, OpenCV displaces corners; `near`, (n, 2) px, are corners
        of squares found otherwise, to correct them.
        """
        part = cut_out(image, region, most_px=_SQUARE_SEARCH_SIDE_PX)
        calm = smooth_for_square_search(part.image)
        if calm is None:
            return []
        size = (self.target.columns, self.target.rows)
        for method in methods:
            # smoothing makes the search by sectors miss corners beside a dark background
            complete, found = method(part.image if method is _BY_SECTORS else calm, size)
            if not complete:
                continue
            grid = part.in_whole(found).reshape(*size[::-1], 2)
            if near is not None:
                grid = _correct_displaced(grid, near)
            detection = self._ordered(image, grid, 1.0 / part.scale)
            if detection is not None:
                return [detection]
        return []

    def _ordered(self, image: Image, grid: Grid, initial_error_px: float) -> BoardDetection | None:
        """Detection for corners that OpenCV found, in the first order that reads correctly."""
        orders = [grid, grid[::-1, ::-1], grid[::-1], grid[:, ::-1]]
        if self.target.columns == self.target.rows:
            orders += [np.swapaxes(order, 0, 1) for order in orders]
        orders = [order for order in orders if is_even_unmirrored_grid(order)]
        back = [order[0, 0] - order[0, -1] for order in orders]
        rightmost = np.argsort([each[0] / np.linalg.norm(each) for each in back], kind="stable")
        for dark in self._first_dark:
            for k in rightmost:
                detection = self._at(image, orders[k], initial_error_px, first_dark=(dark,))
                if detection is not None:
                    return detection
        return None

    def _refined(self, frame: Frame, predicted: BoardDetection) -> BoardDetection | None:
        if not in_image(frame.grey, predicted.corners_px).all():
            return None
        grid = predicted.corners_px.reshape(self.target.rows, self.target.columns, 2)
        # a narrow window first: one wide enough for a moved target is less exact
        for error_squares in (0.0, _PREDICTION_ERROR_SQUARES):
            error_px = error_squares * shortest_square_edge_px(grid)
            most = MAX_TRACKED_MOVE_SQUARES
            found = self._at(frame.grey, grid, error_px, most, self._first_dark)
            if found is not None:
                return found
        return None

    @property
    def _first_dark(self) -> tuple[bool, ...]:
        """Colours of the square before the first corner to try, True for dark.

        A turn by 180 degrees makes it dark, except on symmetric boards, which may have either.
        """
        return (True, False) if self.target.symmetric else (True,)

    def _at(
        self,
        image: Image,
        grid: Grid,
        initial_error_px: float,
        step_squares: float = math.inf,
        first_dark: tuple[bool, ...] = (True,),
    ) -> BoardDetection | None:
        """Refine corners with an initial error and read the board; None if one is out of place."""
        square = shortest_square_edge_px(grid)
        if not square >= _LEAST_SQUARE_PX:
            return None
        most = min(max(_LARGE_WINDOW_SQUARES * square, WINDOW_PX[1]), _LARGE_WINDOW_PX)
        half_side_px = window_half_side_px(WINDOW_FRACTION * square, (WINDOW_PX[0], round(most)))
        corners = grid.reshape(-1, 2)
        # corners of a reduced image, for example, are too inexact for the small window
        if initial_error_px > 1.0:
            wide = int(min(max(round(0.4 * square), half_side_px), 4 * initial_error_px))
            corners = refine_corners(image, corners, wide)
        refined, moved, settled, sigmas = refine_and_check(image, corners, half_side_px)
        if (
            moved.max() > min(step_squares * square, half_side_px + 1.0)
            or (~settled).mean() > _MAX_STRAY_FRACTION
        ):
            return None
        grid = refined.reshape(grid.shape)
        mistaken = _asymmetries(image, refined, square) >= _MAX_ASYMMETRY
        before = refined.copy()
        if mistaken.any():
            refined[mistaken] = _refine_stray(image, _by_neighbours(grid)[mistaken], square)
            if not np.isfinite(refined).all():
                return None
        if not is_even_unmirrored_grid(grid) or not any(
            squares_alternate(image, grid, dark) and not board_continues_beyond(image, grid, dark)
            for dark in first_dark
        ):
            return None
        flat = self._flat(refined)
        again = _refine_all_strays(image, grid, square, flat)
        if again is None:
            return None
        refined, beside = again
        grid_sigma_px = corner_scatter_px(flat.to_plane(refined).reshape(grid.shape))
        if grid_sigma_px > max(_MAX_SCATTER_SQUARES * square, _MAX_SCATTER_PX):
            return None
        if not np.array_equal(refined, before):
            sigmas = unit_sigmas(image, refined, half_side_px)
        sigmas = pixel_noise_grey(image, square_centres(grid)) * sigmas
        sigmas = np.maximum(np.maximum(sigmas, grid_sigma_px), beside[:, None])
        first = self.target.columns - 1
        point, sigma = refined[first], sigmas[first]
        if self.target.symmetric:
            # the diagonals cross in the centre; each of four corners moves it by about a quarter
            outer = [0, first, len(refined) - 1, len(refined) - self.target.columns]
            point = flat.to_pixels(_diagonal_crossing(flat.to_plane(refined[outer]))[None])[0]
            sigma = 0.5 * np.sqrt((sigmas[outer] ** 2).mean(axis=0))
        return BoardDetection(self.target, point, refined, sigma, sigmas, camera=self.camera)


def _correct_displaced(grid: Grid, near: FloatArray) -> Grid:
    """Replace displaced corners by those of `near` that match them."""
    from scipy.optimize import linear_sum_assignment
    from scipy.spatial.distance import cdist

    corners = grid.reshape(-1, 2)
    square = float(np.median(np.linalg.norm(np.diff(grid, axis=1), axis=-1)))
    least, most = (share * square for share in _CORRECTED_ERROR_SQUARES)
    away = np.minimum(cdist(corners, near), most)
    which, place = linear_sum_assignment(away**2)
    astray = (away[which, place] > least) & (away[which, place] < most)
    out = corners.copy()
    out[which[astray]] = near[place[astray]]
    return out.reshape(grid.shape)


def _refine_all_strays(
    image: Image, grid: Grid, square: float, flat: FlatView
) -> tuple[FloatArray, FloatArray] | None:
    """Refine stray corners from their predictions; None if one does not agree in the end.

    A shadow, a spot or an error of the search moves a single corner and leaves its squares
    readable. Also the residuals of doubtful ones, (n,) px, 0 for the others.
    """
    corners, strays = grid.reshape(-1, 2).copy(), np.zeros(grid[..., 0].size, bool)
    for last in range(_MAX_STRAY_ROUNDS + 1):
        ideal = flat.to_plane(corners)
        left, spread = loo_residuals_and_scales(ideal.reshape(grid.shape))
        beside = np.linalg.norm(left, axis=1) / spread
        usual = float(np.median(beside))
        now = beside > max(_STRAY_PX, _STRAY_RATIO * usual)
        if last == _MAX_STRAY_ROUNDS or not now.any():
            break
        strays |= now
        start = flat.to_pixels((ideal - left)[strays])
        again = _refine_stray(image, start, square)
        corners[strays] = np.where(np.isfinite(again), again, corners[strays])
    if beside.max() > max(
        _FATAL_RESIDUAL_PX, _FATAL_RESIDUAL_SQUARES * square, _FATAL_RESIDUAL_RATIO * usual
    ):
        return None
    doubtful = strays | now
    if doubtful.any():
        doubtful &= _asymmetries(image, corners, square) > _CLEAR_ASYMMETRY
    return corners, np.where(doubtful, beside * spread, 0.0)


def _refine_stray(image: Image, corners: FloatArray, square: float) -> FloatArray:
    """Refine corners from predictions; nan where no edges cross nearby."""
    half_side_px = window_half_side_px(_STRAY_WINDOW_SQUARES * square, _STRAY_WINDOW_PX)
    again = refine_corners_robustly(image, np.ascontiguousarray(corners), half_side_px)
    asymmetry = _asymmetries(image, np.where(np.isfinite(again), again, corners), square)
    return np.where((asymmetry < _MAX_ASYMMETRY)[:, None], again, np.nan)


def _asymmetries(image: Image, corners: FloatArray, square: float) -> FloatArray:
    """(n,) asymmetries of corners of squares with edges of a length."""
    half_side_px = window_half_side_px(_CROSSING_SQUARES * square, _CROSSING_PX)
    return crossing_asymmetries(image, np.ascontiguousarray(corners), half_side_px)


def _by_neighbours(grid: Grid) -> FloatArray:
    """(n, 2) prediction of each corner as the fourth one of the parallelograms beside it."""
    around = np.pad(grid, ((1, 1), (1, 1), (0, 0)), constant_values=np.nan)
    places = [
        np.roll(around, (i, 0), (0, 1)) + np.roll(around, (0, j), (0, 1))
        - np.roll(around, (i, j), (0, 1)) for i in (-1, 1) for j in (-1, 1)
    ]  # fmt: skip
    return np.asarray(np.nanmedian(np.stack(places)[:, 1:-1, 1:-1], axis=0).reshape(-1, 2))


def _diagonal_crossing(quad: FloatArray) -> FloatArray:
    """Crossing of a quadrilateral's diagonals, shape (2,); its corners in cyclic order, (4, 2)."""
    (ax, ay), (bx, by), (cx, cy), (dx, dy) = quad.tolist()
    ux, uy, vx, vy = cx - ax, cy - ay, dx - bx, dy - by
    share = ((bx - ax) * vy - (by - ay) * vx) / (ux * vy - uy * vx)
    return np.array([ax + share * ux, ay + share * uy])
