"""Detecting checkerboards: all inner corners, in the board's order."""

import math
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.models.boards import Checkerboard
from vergence.vision.boards.corners import corner_sigmas, noise_of, refine_corners
from vergence.vision.boards.squares import (
    Grid,
    goes_on,
    has_stray_corner,
    is_regular,
    middles,
    reads,
    shortest_square,
    unevenness,
)
from vergence.vision.detection import Detection, Detector
from vergence.vision.image import smoothed

_WINDOW_SQUARES: Final = 0.6
"""Half side of the refinement window in squares: a full square would see the next edge."""
_WINDOW_PX: Final = (2, 5)
_LEAST_SQUARE_PX: Final = 2.5
_TRACKED_STEP: Final = 0.35
"""How far a corner may lie from its prediction, in squares, before the region is searched anew."""
_UNEVEN_SQUARES: Final = 0.1
_UNEVEN_PX: Final = 1.0
"""More than both, as a standard deviation, is smeared beyond use, or no board."""
_SEARCH_PX: Final = 1600
"""Larger images are reduced to this where squares are looked for."""


class CheckerboardDetector(Detector[Checkerboard]):
    """Detects a checkerboard; the measured point is its upper right corner, or its middle.

    A board that looks the same turned by 180 degrees, or by 90, has its corners in that of the
    possible orders whose first line points most to the right.
    """

    def _detect_some(self, image: NDArray[np.uint8], way: int | None = None) -> list[Detection]:
        return self._first_of(image, (_by_squares,))

    def _detect_all(self, image: NDArray[np.uint8]) -> list[Detection]:
        return self._first_of(image, (_by_squares, _by_equalised_squares, _by_sectors))

    def _detect_in(
        self, image: NDArray[np.uint8], region: tuple[int, int, int, int], predicted: Detection
    ) -> list[Detection]:
        x0, y0, x1, y1 = region
        part = np.ascontiguousarray(image[y0:y1, x0:x1])
        return self._first_of(image, (_by_squares,), part, np.array([x0, y0], float))

    def _first_of(
        self,
        image: NDArray[np.uint8],
        ways: tuple[Any, ...],
        part: NDArray[np.uint8] | None = None,
        shift: NDArray[np.float64] | float = 0.0,
    ) -> list[Detection]:
        """What the first way finds that finds the board in an image, or a part of it."""
        part = image if part is None else part
        scale = min(_SEARCH_PX / max(part.shape), 1.0)
        small = part
        if scale < 1.0:
            area = cv2.INTER_AREA
            small = np.asarray(cv2.resize(part, None, fx=scale, fy=scale, interpolation=area))
        calm = smoothed(small)
        if calm is None:
            return []
        size = (self.target.columns, self.target.rows)
        tries = [(way, calm) for way in ways]
        if calm is not small and _by_sectors in ways:
            tries.append((_by_sectors, small))  # smoothing costs corners beside a dark background
        for way, looked_at in tries:
            found = way(looked_at, size)
            if found is None:
                continue
            corners = (np.asarray(found, float).reshape(-1, 2) + 0.5) / scale - 0.5 + shift
            detection = self._ordered(image, corners.reshape(size[1], size[0], 2), 1.0 / scale)
            if detection is not None:
                return [detection]
        return []

    def _ordered(self, image: NDArray[np.uint8], grid: Grid, coarse_px: float) -> Detection | None:
        """The board whose corners OpenCV found, in one of its orders."""
        orders = [grid, grid[::-1, ::-1], grid[::-1], grid[:, ::-1]]
        if self.target.columns == self.target.rows:
            orders += [np.swapaxes(order, 0, 1) for order in orders]
        orders = [order for order in orders if is_regular(order)]
        orders.sort(key=_to_the_right)
        # turned by 180 degrees a symmetric board keeps its colours, and it may have either
        for dark in (True, False) if self.target.symmetric else (True,):
            for order in orders:
                detection = self._at(image, order, max(coarse_px, 1.0), first_dark=dark)
                if detection is not None:
                    return detection
        return None

    def _refined(self, image: NDArray[np.uint8], predicted: Detection) -> Detection | None:
        size = (self.target.rows, self.target.columns, 2)
        height, width = image.shape
        corners = predicted.corners_px
        if not ((corners > 0.0) & (corners < (width - 1.0, height - 1.0))).all():
            return None
        grid = corners.reshape(size)
        found = self._at(image, grid, 0.0, _TRACKED_STEP)
        if found is None and self.target.symmetric:
            found = self._at(image, grid, 0.0, _TRACKED_STEP, first_dark=False)
        return found

    def _at(
        self,
        image: NDArray[np.uint8],
        grid: Grid,
        coarse_px: float,
        step_squares: float = math.inf,
        *,
        first_dark: bool = True,
    ) -> Detection | None:
        """Refine corners and read the board; None where one of them is not in its place."""
        square = shortest_square(grid)
        if not square >= _LEAST_SQUARE_PX:
            return None
        side = int(min(max(round(_WINDOW_SQUARES * square), _WINDOW_PX[0]), _WINDOW_PX[1]))
        corners = grid.reshape(-1, 2)
        if coarse_px > 1.0:  # corners of a reduced image, too far for so small a window
            wide = int(min(max(round(0.4 * square), side), 4 * coarse_px))
            corners = refine_corners(image, corners, wide)
        refined = refine_corners(image, corners, side)
        if np.abs(refined - corners).max() > min(step_squares * square, side + 1.0):
            return None
        grid = refined.reshape(grid.shape)
        if not is_regular(grid):
            return None
        if not reads(image, grid, first_dark=first_dark):
            return None
        # a board that is followed from image to image does not grow
        if step_squares == math.inf and goes_on(image, grid, first_dark=first_dark):
            return None
        if has_stray_corner(grid):
            return None
        uneven = unevenness(self._ideal(refined).reshape(grid.shape))
        if uneven > max(_UNEVEN_SQUARES * square, _UNEVEN_PX):
            return None
        noise = noise_of(image, middles(grid))
        sigmas = np.maximum(corner_sigmas(image, refined, side, noise), uneven)
        if not self.target.symmetric:
            first = self.target.columns - 1
            return Detection(self.target, refined[first], refined, sigmas[first], sigmas)
        # diagonals cross in the middle; each of four corners moves it by about a quarter
        outer = [0, self.target.columns - 1, len(refined) - 1, len(refined) - self.target.columns]
        point = crossing(self._ideal(refined[outer]))
        sigma = 0.5 * np.sqrt((sigmas[outer] ** 2).mean(axis=0))
        return Detection(self.target, self._seen(point), refined, sigma, sigmas)


def _by_squares(image: NDArray[np.uint8], size: tuple[int, int]) -> Any:
    # Not OpenCV's other two defaults: equalising the histogram of a board before a plain
    # background raises the noise, and the fast check misses boards of 100 px.
    complete, found = cv2.findChessboardCorners(image, size, flags=cv2.CALIB_CB_ADAPTIVE_THRESH)
    return found if complete else None


def _by_equalised_squares(image: NDArray[np.uint8], size: tuple[int, int]) -> Any:
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    complete, found = cv2.findChessboardCorners(image, size, flags=flags)
    return found if complete else None


def _by_sectors(image: NDArray[np.uint8], size: tuple[int, int]) -> Any:
    complete, found = cv2.findChessboardCornersSB(
        image, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE
    )
    return found if complete else None


def _to_the_right(grid: Grid) -> float:
    """Minus the cosine of the first line's direction."""
    along = grid[0, -1] - grid[0, 0]
    return -float(along[0] / np.linalg.norm(along))


def crossing(quad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where the diagonals of a quadrilateral cross, shape (2,), of its corners in turn (4, 2)."""
    (ax, ay), (bx, by), (cx, cy), (dx, dy) = quad.tolist()
    ux, uy, vx, vy = cx - ax, cy - ay, dx - bx, dy - by
    share = ((bx - ax) * vy - (by - ay) * vx) / (ux * vy - uy * vx)
    return np.array([ax + share * ux, ay + share * uy])
