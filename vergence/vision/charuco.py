"""Detection of ChArUco boards, whole or in part, in both layouts of OpenCV."""

from dataclasses import replace
from functools import lru_cache
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.errors import ConfigurationError
from vergence.models.camera import Camera, CameraResponse
from vergence.models.parts import FloatArray
from vergence.vision.corners import (
    DEFAULT_SIGMA_PX,
    MAX_ENLARGED_PIXELS,
    MAX_TRACKED_MOVE_SQUARES,
    WINDOW_FRACTION,
    WINDOW_PX,
    corner_scatter_px,
    in_image,
    pixel_noise_grey,
    refine_and_check,
    shortest_square_edge_px,
    square_centres,
    window_half_side_px,
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
from vergence.vision.tag_families import AprilGrid
from vergence.vision.targets import CharucoBoard

_PROBE_MARGINS: Final = 0.45
"""Distance of grey samples from a corner along both axes, in margins of a marker (chosen)."""
_LEAST_MARKER_CORRELATION: Final = 0.4
"""Least correlation of a marker's grey levels with its print (chosen)."""
_WINDOW_MARGINS: Final = 0.85
"""Half side of the refinement window, in margins of a marker; it must not contain the marker's
corners (chosen)."""
_LEAST_CORNERS: Final = 4
"""Least number of corners, as a homography needs (numerical)."""
_MAX_RESIDUAL_SQUARES: Final = 0.3
"""Largest residual of a corner from the homography of all, in squares (chosen: outliers against
lens distortion)."""
_LEAST_PERIMETER: Final = 0.01
"""Least perimeter of a marker, as a fraction of the longer side of the searched image (chosen:
small markers against time)."""
_LEAST_PERIMETER_PX: Final = 24.0
"""Least perimeter of a marker, px: one pixel per bit of the smallest markers with their borders,
the least that can be read (chosen)."""
_QUICK_SEARCH_SIDE_PX: Final = 1280
"""Longer side to which larger images are first reduced in loops at camera rate, px (chosen: time
against small markers)."""
_MAX_LATTICE_ERROR_SQUARES: Final = 0.25
"""Largest distance of a corner of a marker from its place in a square of the lattice, in squares
(chosen: lens distortion against markers of others)."""
_CORNER_SIGNS: Final = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
"""Directions from a marker's middle to its corners (numerical)."""


def upper_left_is_dark(board: CharucoBoard) -> bool:
    """True if the board's upper left square is black."""
    return not (board.legacy and board.rows % 2 == 0)


class CharucoDetector(BoardDetector[CharucoBoard]):
    """Detects a ChArUco board; the measured point is its centre.

    Unless the target states the layout of OpenCV before 4.6, both layouts are tried if they differ.
    """

    def __init__(
        self,
        target: CharucoBoard,
        camera: Camera | None = None,
        response: CameraResponse | None = None,
    ) -> None:
        super().__init__(target, camera, response)
        self._layouts = [target]
        if target.rows % 2 == 0 and not target.legacy:
            self._layouts.append(replace(target, legacy=True))

    def _detect_some(self, frame: Frame, way: int | None = None) -> list[BoardDetection]:
        """Search a large image reduced, then at full size unless all corners are found.

        An odd `way` skips the first step; an even one stops after it if nothing is found.
        """
        scale = min(_QUICK_SEARCH_SIDE_PX / max(frame.grey.shape), 1.0)
        if scale == 1.0 or (way is not None and way % 2):
            return self._search(frame.grey)
        found = self._search(frame.grey, scale)
        whole = bool(found) and bool(np.isfinite(found[0].corners_px).all())
        if whole or (way is not None and not found):
            return found
        return _most(found + self._search(frame.grey))  # small markers may be missing

    def _detect_all(self, frame: Frame) -> list[BoardDetection]:
        return self._detect_some(frame) or self._detect_rest(frame)

    def _detect_rest(self, frame: Frame) -> list[BoardDetection]:
        return self._search(frame.grey, 2.0) if frame.grey.size <= MAX_ENLARGED_PIXELS else []

    def _detect_in(
        self, frame: Frame, region: Region, predicted: BoardDetection
    ) -> list[BoardDetection]:
        return self._search(frame.grey, 1.0, region)

    def _search(
        self, image: Image, scale: float = 1.0, region: Region | None = None
    ) -> list[BoardDetection]:
        """Detection in the layout with most corners, in an image or a region of it, scaled."""
        part = cut_out(image, region, scale)
        board = self.target
        every = board.opencv_board().getDictionary()
        some = every.bytesList[: (board.columns + 2) * (board.rows + 2) // 2]  # of larger boards
        dictionary = cv2.aruco.Dictionary(some, every.markerSize, every.maxCorrectionBits)
        markers, numbers = find_markers(part.image, dictionary)
        own = numbers < board.columns * board.rows // 2
        if not own.any():  # OpenCV would search for them again
            return []
        found = []
        ids: Any
        seen = part.in_whole(markers)
        for board in self._layouts:
            search = cv2.aruco.CharucoDetector(board.opencv_board())
            corners, ids, *_ = search.detectBoard(
                part.image, markerCorners=list(markers[own]), markerIds=numbers[own]
            )
            if ids is None or len(ids) < _LEAST_CORNERS:
                continue
            places = np.full((len(board.corners_m), 2), np.nan)
            places[np.ravel(ids)] = part.in_whole(np.reshape(corners, (-1, 2)))
            detection = self._at(image, board, places)
            if detection is not None and not self._is_of_another(board, detection, seen, numbers):
                found.append(detection)
        return _most(found)

    def _is_of_another(
        self,
        board: CharucoBoard,
        found: BoardDetection,
        markers: FloatArray,
        numbers: NDArray[np.intp],
    ) -> bool:
        """True if markers on the board's lattice, or next to it, are not those of the board."""
        known = np.isfinite(found.corners_px).all(axis=1)
        flat = self._flat(found.corners_px[known])
        to_board = fit_homography(
            flat.to_plane(found.corners_px[known]), board.corners_m[known] / board.square_m
        )
        if to_board is None:
            return False
        counts = np.array([board.columns, board.rows])
        corners = flat.to_plane(markers.reshape(-1, 2))
        corners = cv2.perspectiveTransform(corners[None], to_board)[0] + 0.5 * counts
        corners = corners.reshape(-1, 4, 2)
        square = np.floor(corners.mean(axis=1))
        half = 0.5 * board.marker_m / board.square_m
        printed = square[:, None] + 0.5 + half * _CORNER_SIGNS
        on = (np.abs(corners - printed) < _MAX_LATTICE_ERROR_SQUARES).all(axis=(1, 2))
        on &= ((square >= -1) & (square <= counts)).all(axis=1)
        inside = ((square >= 0) & (square < counts)).all(axis=1)
        own = np.floor(marker_corners_m(board).mean(axis=1) / board.square_m)
        right = (own[np.minimum(numbers, len(own) - 1)] == square).all(axis=1)
        right &= numbers < len(own)
        wrong = int((on & inside & ~right).sum())
        return bool((on & ~inside).any() or wrong > MAX_OTHER_FRACTION * int((on & right).sum()))

    def _refined(self, frame: Frame, predicted: BoardDetection) -> BoardDetection | None:
        assert isinstance(predicted.target, CharucoBoard)
        return self._at(
            frame.grey, predicted.target, predicted.corners_px, MAX_TRACKED_MOVE_SQUARES
        )

    def _at(
        self,
        image: Image,
        board: CharucoBoard,
        places: FloatArray,
        step_squares: float | None = None,
    ) -> BoardDetection | None:
        """Refine given corners; None if they do not form the board."""
        known = np.flatnonzero(in_image(image, places))
        if len(known) < _LEAST_CORNERS:
            return None
        corners, board_m = places[known], board.corners_m[known]
        flat = self._flat(corners)
        grid = np.full((board.rows - 1, board.columns - 1, 2), np.nan)
        by_number = grid.reshape(-1, 2)
        by_number[known] = corners
        square = shortest_square_edge_px(grid)
        if not np.isfinite(square):  # no two corners are neighbours
            size, size_m = (np.linalg.norm(np.ptp(each, axis=0)) for each in (corners, board_m))
            square = float(size / size_m * board.square_m)
        margin = 0.5 * (1.0 - board.marker_m / board.square_m) * square
        wide = min(WINDOW_FRACTION * square, max(_WINDOW_MARGINS * margin, WINDOW_PX[0]))
        half_side_px = window_half_side_px(wide)
        refined, moved, settled, unit = refine_and_check(image, corners, half_side_px)
        limit = half_side_px + 1.0 if step_squares is None else step_squares * square
        used = settled & (moved <= limit)
        ideal = flat.to_plane(refined)
        enough = used.sum() >= _LEAST_CORNERS
        transform = fit_homography(board_m[used], ideal[used]) if enough else None
        if transform is None:
            return None
        off = cv2.perspectiveTransform(board_m[None], transform)[0] - ideal
        near = np.linalg.norm(off, axis=1) <= _MAX_RESIDUAL_SQUARES * square
        # black and white must alternate around a corner as printed
        away = _PROBE_MARGINS * 0.5 * (board.square_m - board.marker_m)
        greys = _greys(image, flat, transform, board_m[:, None] + away * CORNER_PROBES)
        row, column = np.divmod(known, board.columns - 1)
        dark = ((row + column) % 2 == 0) == upper_left_is_dark(board)
        contrast = corner_contrasts(greys, np.where(dark, 1.0, -1.0))
        good = used & near & (contrast > least_corner_contrast(contrast))
        if good.sum() < max(_LEAST_CORNERS, len(known) // 2):
            return None
        known, refined, ideal, unit = known[good], refined[good], ideal[good], unit[good]
        beside = np.zeros((board.rows, board.columns), bool)
        for down, right in np.ndindex(2, 2):
            beside[row[good] + down, column[good] + right] = True
        squares, markers_m, printed = _markers(board)
        shown = _greys(image, flat, transform, markers_m[beside.ravel()[squares]])
        alike = (normalised(shown) * printed[beside.ravel()[squares]]).sum(axis=1)
        if (alike > _LEAST_MARKER_CORRELATION).mean() < LEAST_CONFIRMED_FRACTION:
            return None
        even = np.full(grid.shape, np.nan)
        by_number[:], even.reshape(-1, 2)[known] = np.nan, ideal
        by_number[known] = refined
        # inner squares without a marker
        plain = (np.indices(grid.shape[:2]).sum(axis=0) % 2 == 0) == upper_left_is_dark(board)
        middles = square_centres(grid)[plain[:-1, :-1].ravel()]
        noise = pixel_noise_grey(image, middles[np.isfinite(middles).all(axis=1)])
        sigmas = np.full(by_number.shape, np.nan)
        grid_sigma_px = corner_scatter_px(even) or DEFAULT_SIGMA_PX
        sigmas[known] = np.maximum(noise * unit, grid_sigma_px)
        if not np.array_equal(good, used):  # fit again without the outliers
            transform = fit_homography(board.corners_m[known], ideal)
            if transform is None:
                return None
        point = cv2.perspectiveTransform(np.zeros((1, 1, 2)), transform)[0, 0]
        sigma = origin_sigma_px(transform, board.corners_m[known], sigmas[known])
        point = flat.to_pixels(point[None])[0]
        return BoardDetection(board, point, by_number, sigma, sigmas, camera=self.camera)


def find_markers(
    image: Image, dictionary: cv2.aruco.Dictionary
) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
    """Find the markers of a dictionary in an image.

    Returns:
        (n, 4, 2) their corners, px, from the upper left of the print, clockwise; (n,) numbers.
    """
    parameters = cv2.aruco.DetectorParameters()
    least = _LEAST_PERIMETER_PX / max(image.shape)
    parameters.minMarkerPerimeterRate = max(_LEAST_PERIMETER, least)
    corners, numbers, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(image)
    if not corners:
        return np.zeros((0, 4, 2), np.float32), np.zeros(0, np.intp)
    return np.reshape(np.asarray(corners, np.float32), (-1, 4, 2)), np.ravel(numbers)


def marker_corners_m(board: CharucoBoard) -> FloatArray:
    """Corners of the markers by number, (n, 4, 2), m right and down from the upper left."""
    points = np.asarray(board.opencv_board().getObjPoints(), float)
    return np.asarray(points[..., :2])


def _most(found: list[BoardDetection]) -> list[BoardDetection]:
    """Detection with the most corners, if any."""
    return sorted(found, key=lambda each: -int(np.isfinite(each.corners_px[:, 0]).sum()))[:1]


def _greys(image: Image, flat: FlatView, transform: FloatArray, board_m: FloatArray) -> FloatArray:
    """Grey levels, (n, m), at positions on the board, (n, m, 2) m."""
    plane = np.asarray(cv2.perspectiveTransform(board_m.reshape(1, -1, 2), transform)[0], float)
    return grey_at_pixels(image, flat.to_pixels(plane).reshape(board_m.shape))


@lru_cache(maxsize=8)
def _markers(board: CharucoBoard) -> tuple[NDArray[np.intp], FloatArray, FloatArray]:
    """Squares with a marker, centres of their cells, (n, cells, 2) m, and normalised prints."""
    rows, columns = board.rows, board.columns
    size = len(board.cells) // rows
    x, y = (np.arange(size * count) + 0.5 for count in (columns, rows))
    middles_m = board.cell_m * (np.stack(np.meshgrid(x, y), axis=-1) - board.origin_cells)
    by_square = (rows, size, columns, size)
    places_m = middles_m.reshape(*by_square, 2).swapaxes(1, 2).reshape(rows * columns, -1, 2)
    cells = board.cells.astype(float).reshape(by_square).swapaxes(1, 2)
    printed = cells.reshape(rows * columns, -1)
    marked = np.flatnonzero(np.ptp(printed, axis=1))
    return marked, places_m[marked], normalised(printed[marked])


_MOST_COLUMNS: Final = 24
"""Largest number of columns that is tried (chosen: search time)."""
LEAST_ARRANGED_FRACTION: Final = 0.6
"""Least fraction of the markers in an image that must be arranged as on one board (chosen)."""
_MAX_ERROR_EDGES: Final = 0.25
"""Largest distance of a marker's corner from its place on a board, in edges of a marker (chosen:
allows for lens distortion)."""
_DRAWS: Final = 100
"""Draws of four corners for a board (chosen: search time; 60 % good ones need 22 for 95 %)."""


def alternative_columns(missed: CharucoBoard | AprilGrid, least: int) -> list[int]:
    """Columns to try for a board that is not the one asked for, first those of its sides."""
    return list(dict.fromkeys([missed.columns, missed.rows, *range(least, _MOST_COLUMNS + 1)]))


def alternative_charuco(
    corners: NDArray[np.float32], numbers: NDArray[np.intp], missed: CharucoBoard, dictionary: str
) -> CharucoBoard | None:
    """Board on which most markers, as `find_markers` gives them, are arranged as in an image.

    It has the sizes of the board that was missed and as many rows as the markers need. None if too
    few markers agree.
    """
    edge = float(np.median(np.linalg.norm(corners[:, 0] - corners[:, 1], axis=1)))
    best, most = None, LEAST_ARRANGED_FRACTION * corners.size / 2
    squares = 2 * (int(numbers.max()) + 1)
    for columns in alternative_columns(missed, 3):
        rows = max(3, -(-squares // columns), missed.rows if columns == missed.columns else 0)
        for legacy in (False, True):
            even = rows + rows % 2 if legacy else rows
            try:
                board = replace(
                    missed, columns=columns, rows=even, legacy=legacy, dictionary=dictionary
                )
            except ConfigurationError:  # too many markers for the dictionary
                continue
            places = marker_corners_m(board)[numbers].reshape(-1, 2)
            fitted: Any = cv2.findHomography(
                places, corners.reshape(-1, 2), cv2.RANSAC, _MAX_ERROR_EDGES * edge, maxIters=_DRAWS
            )
            if fitted[0] is not None and fitted[1].sum() > most:
                best, most = board, fitted[1].sum()
    return best
