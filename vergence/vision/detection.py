"""Detecting a planar target: the pixel of its measured point.

Pixels follow OpenCV: the centre of the upper left pixel is (0, 0). OpenCV's refinement named
APRILTAG counts from the pixel's corner instead and is not used; corners are refined by
``cornerSubPix``, which keeps the convention.

A detector accepts only what it can read in full: after refinement every cell of the board is
sampled through the homography of the corners and compared with what is printed there, and its
edges must be sharp. A target that is half hidden or smeared by motion is None, never a wrong
point.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.models.boards import AprilTag, Checkerboard, PlanarTarget, tag_dictionary
from vergence.vision.board_reader import NO_SHIFT, BoardReader
from vergence.vision.optics import EyeCamera

_REFINEMENT_END = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 30, 3e-3)
_REFINEMENT_BLUR_PX = 0.6
_WINDOW_CELLS = 0.6
"""Half side of the refinement window in cells: a full cell would see the next edge."""
_WINDOW_PX = (2, 5)
_LEAST_CELL_PX = 2.5
_TRACKED_STEP_CELLS = 0.35
"""How far a corner may lie from its prediction before the region is searched anew."""
_REGION_MARGIN_CELLS = 2.5
_REGION_MARGIN_PX = 16
"""Margin of the tracked region around the outermost corners: a checkerboard's lie two cells
inside its rim, and the rest is for an error of prediction."""


class Detection(NamedTuple):
    """Where the target is in an image."""

    point_px: NDArray[np.float64]
    """The measured point, (u, v), shape (2,)."""
    corners_px: NDArray[np.float64]
    """Its refined corners in the order of the target's ``corners_m``, shape (n, 2)."""


class Detector(ABC):
    """Finds one target in images of one eye.

    Attributes:
        target: the board to look for.
        camera: the eye whose lens distortion is taken into account, or None for a pinhole.
    """

    def __init__(
        self, target: PlanarTarget, camera: EyeCamera | None, outer: Sequence[int]
    ) -> None:
        """Prepare what depends on the target alone, whose outermost corners these are."""
        self.target = target
        self.camera = camera if camera is not None and camera.distorts else None
        self._reader = BoardReader(target, outer, self.camera)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as the arguments: OpenCV's detector cannot be pickled."""
        return type(self), (self.target, self.camera)

    def detect(self, image: NDArray[np.uint8]) -> Detection | None:
        """Search a whole image.

        Args:
            image: grey levels, shape (height, width).

        Returns:
            The detection, or None where no complete target can be read.
        """
        found = self._search(image)
        return None if found is None else self._refined(image, found)

    def track(
        self, image: NDArray[np.uint8], around_px: ArrayLike, previous: Detection
    ) -> Detection | None:
        """Look for the target near a predicted point only.

        The last corners are moved along and refined; where that fails, a region as large as the
        last detection, with a margin, is searched.

        Args:
            image: grey levels, shape (height, width).
            around_px: predicted measured point (u, v), shape (2,).
            previous: the last detection, which tells size and shape.

        Returns:
            The detection, or None where no complete target can be read.
        """
        moved = previous.corners_px + (np.asarray(around_px, float) - previous.point_px)
        height, width = image.shape
        if all(0.0 <= u < width and 0.0 <= v < height for u, v in moved.tolist()):
            detection = self._refined(image, moved, _TRACKED_STEP_CELLS)
            if detection is not None:
                return detection
        low, high = moved.min(axis=0), moved.max(axis=0)
        margin = _REGION_MARGIN_CELLS * self._cell_px(moved) + _REGION_MARGIN_PX
        x0, y0 = np.maximum(np.floor(low - margin), 0).astype(int).tolist()
        x1, y1 = np.minimum(np.ceil(high + margin) + 1, (width, height)).astype(int).tolist()
        if x1 - x0 < 8 or y1 - y0 < 8:
            return None
        shift = np.array([x0, y0])
        found = self._search(image[y0:y1, x0:x1], shift)
        return None if found is None else self._refined(image, found + shift)

    @abstractmethod
    def _search(
        self, image: NDArray[np.uint8], shift: NDArray[np.int_] = NO_SHIFT
    ) -> NDArray[np.float64] | None:
        """Corners to a pixel or two, in the target's order, shape (n, 2).

        Args:
            image: all of an image or a part of it, in whose pixels the corners are.
            shift: of its upper left pixel in the whole image, shape (2,).
        """

    @abstractmethod
    def _cell_px(self, corners: NDArray[np.float64]) -> float:
        """Length of a cell in the image where it is shortest."""

    @abstractmethod
    def _point(self, corners: NDArray[np.float64]) -> NDArray[np.float64]:
        """The measured point from the refined corners."""

    def _refined(
        self,
        image: NDArray[np.uint8],
        corners: NDArray[np.float64],
        step_cells: float = math.inf,
    ) -> Detection | None:
        """Refine corners and read the board; None where a cell or a corner is not in its place."""
        cell = self._cell_px(corners)
        if cell < _LEAST_CELL_PX:
            return None
        side = int(min(max(round(_WINDOW_CELLS * cell), _WINDOW_PX[0]), _WINDOW_PX[1]))
        refined = _refine(image, corners, side)
        if np.abs(refined - corners).max() > min(step_cells * cell, side + 1):
            return None
        if not self._reader.reads(image, refined, cell):
            return None
        return Detection(self._point(refined), refined)


class TagDetector(Detector):
    """Detects the centre of an AprilTag: the point where its diagonals cross.

    With a camera that distorts, the diagonals are crossed on undistorted rays.
    """

    def __init__(self, target: AprilTag, camera: EyeCamera | None = None) -> None:
        """Prepare OpenCV's detector for this one tag."""
        super().__init__(target, camera, range(4))
        family = tag_dictionary()
        parameters = cv2.aruco.DetectorParameters()
        parameters.adaptiveThreshWinSizeMin = parameters.adaptiveThreshWinSizeMax = 23
        # The board's own outline lies only a cell from the tag's; OpenCV would merge the two
        # and keep the outline, which holds no tag.
        parameters.minMarkerDistanceRate = 0.01
        parameters.minMarkerPerimeterRate = 0.02
        # Bits are read again, without mercy, once the corners are refined.
        parameters.errorCorrectionRate = 1.0
        only = cv2.aruco.Dictionary(
            family.bytesList[target.id : target.id + 1],
            family.markerSize,
            family.maxCorrectionBits,
        )
        self._aruco = cv2.aruco.ArucoDetector(only, parameters)

    def _search(
        self, image: NDArray[np.uint8], shift: NDArray[np.int_] = NO_SHIFT
    ) -> NDArray[np.float64] | None:
        found: Any = self._aruco.detectMarkers(image)
        corners, ids, _ = found
        if ids is None or len(ids) != 1:
            return None
        return np.asarray(corners[0], float).reshape(4, 2)

    def _cell_px(self, corners: NDArray[np.float64]) -> float:
        a, b, c, d = corners.tolist()
        return min(math.dist(a, b), math.dist(b, c), math.dist(c, d), math.dist(d, a)) / 8

    def _point(self, corners: NDArray[np.float64]) -> NDArray[np.float64]:
        if self.camera is None:
            return _crossing(corners)
        ray = _crossing(self.camera.rays(corners))
        pixel: NDArray[np.float64] = self.camera.project([[ray[0], ray[1], 1.0]])[0]
        return pixel


class CheckerboardDetector(Detector):
    """Detects the upper right inner corner of a checkerboard."""

    def __init__(self, target: Checkerboard, camera: EyeCamera | None = None) -> None:
        """Prepare the order of corners."""
        columns, rows = target.columns, target.rows
        self._grid = (columns, rows)
        outer = [0, columns - 1, rows * columns - 1, (rows - 1) * columns]
        super().__init__(target, camera, outer)

    def _search(
        self, image: NDArray[np.uint8], shift: NDArray[np.int_] = NO_SHIFT
    ) -> NDArray[np.float64] | None:
        # Neither of OpenCV's other two defaults: equalising the histogram of a board before a
        # plain background raises the noise, and the fast check misses boards of 100 px.
        complete, found = cv2.findChessboardCorners(
            image, self._grid, flags=cv2.CALIB_CB_ADAPTIVE_THRESH
        )
        if not complete:
            return None
        corners = np.asarray(found, float).reshape(-1, 2)
        # OpenCV may begin at either end of the board; the colours tell which one it was.
        for ordered in (corners, corners[::-1]):
            if self._reader.reads(image, ordered, self._cell_px(ordered), shift):
                return ordered
        return None

    def _cell_px(self, corners: NDArray[np.float64]) -> float:
        columns, rows = self._grid
        grid = corners.reshape(rows, columns, 2)
        along_x, along_y = np.diff(grid, axis=1), np.diff(grid, axis=0)
        shortest = min((along_x**2).sum(axis=-1).min(), (along_y**2).sum(axis=-1).min())
        return math.sqrt(shortest)

    def _point(self, corners: NDArray[np.float64]) -> NDArray[np.float64]:
        corner: NDArray[np.float64] = corners[self._grid[0] - 1]
        return corner


def make_detector(target: PlanarTarget, camera: EyeCamera | None = None) -> Detector:
    """The detector of a target.

    Args:
        target: the board to look for.
        camera: the eye's intrinsics. Needed only where the lens distorts and the target is a
            tag, whose centre is not printed and has to be constructed.
    """
    if isinstance(target, AprilTag):
        return TagDetector(target, camera)
    return CheckerboardDetector(target, camera)


def _refine(
    image: NDArray[np.uint8], corners: NDArray[np.float64], side: int
) -> NDArray[np.float64]:
    """Sub-pixel corners, from a window of 2 side + 1 pixels around each.

    ``cornerSubPix`` differentiates over two pixels, which aliases on edges as sharp as a good
    lens makes them and pulls corners to the pixel grid. A light blur and twice the samples
    divide that bias by three or four.
    """
    rim = side + 4
    whole = np.rint(corners).astype(int) - rim
    strip = _windows(image, whole, 2 * rim + 1)
    smooth = cv2.GaussianBlur(strip, (3, 3), _REFINEMENT_BLUR_PX)
    twice = cv2.resize(smooth, None, fx=2, fy=2, interpolation=cv2.INTER_LINEAR)
    # the windows stand side by side: a corner lies as far to the right as its window does
    shift = whole.astype(float)
    shift[:, 0] -= (2 * rim + 1) * np.arange(len(corners))
    start = ((corners - shift + 0.5) * 2 - 0.5).astype(np.float32)
    fine = cv2.cornerSubPix(twice, start, (2 * side, 2 * side), (-1, -1), _REFINEMENT_END)
    return np.asarray((fine.astype(float) + 0.5) / 2 - 0.5 + shift, float)


def _windows(image: NDArray[np.uint8], corners: NDArray[np.int_], size: int) -> NDArray[np.uint8]:
    """Square windows of an image side by side; beyond its edge its last pixels are repeated."""
    height, width = image.shape
    out = np.empty((size, size * len(corners)), np.uint8)
    for i, (x, y) in enumerate(corners.tolist()):
        place = out[:, i * size : (i + 1) * size]
        if x >= 0 and y >= 0 and x + size <= width and y + size <= height:
            place[:] = image[y : y + size, x : x + size]
        else:
            rows = np.clip(np.arange(y, y + size), 0, height - 1)
            columns = np.clip(np.arange(x, x + size), 0, width - 1)
            place[:] = image[np.ix_(rows, columns)]
    return out


def _crossing(quad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where the diagonals of a quadrilateral cross."""
    (ax, ay), (bx, by), (cx, cy), (dx, dy) = quad.tolist()
    ux, uy, vx, vy = cx - ax, cy - ay, dx - bx, dy - by
    share = ((bx - ax) * vy - (by - ay) * vx) / (ux * vy - uy * vx)
    return np.array([ax + share * ux, ay + share * uy])
