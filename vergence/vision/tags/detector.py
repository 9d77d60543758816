"""Detection of AprilTags: decoding, fit of all edges, and acceptance."""

import math
from functools import lru_cache
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence import interrupts
from vergence.models.camera import Camera, CameraResponse
from vergence.vision.detection import Detection, Detector
from vergence.vision.image import smooth_for_square_search
from vergence.vision.tag_families import (
    CORRECTED_BITS,
    UNPRINTED,
    FoundSquare,
    TagFamilyCode,
    find_squares,
    tag_family,
)
from vergence.vision.tags.fit import TagFit, fit_tag
from vergence.vision.targets import AprilTag, TagFamily

_THRESHOLD_WINDOW_CELLS: Final = 5
"""Side, in cells, of the window around a cell whose lightest and darkest cell give its threshold
(chosen: both colours in the window against shadows within it)."""
_LEAST_DECODED_CONTRAST_GREY: Final = 8.0
"""Smallest median contrast within these windows, grey levels (chosen: dim tags against clutter)."""
_LEAST_BORDER_FRACTION: Final = 0.8
"""Smallest fraction of the border's cells that have its colour (chosen: covered tags against
clutter)."""


def decode_tag(
    image: NDArray[np.uint8], corners: NDArray[np.float64], code: TagFamilyCode
) -> FoundSquare | None:
    """Decode a square that may be a tag of a family.

    The libraries fit one plane of grey levels to the whole square; the local thresholds used here
    also read a square in which a shadow ends.

    Args:
        image: grey levels, shape (height, width).
        corners: corners of the square, in order around it, px, shape (4, 2).
        code: the family.

    Returns:
        The tag with the fewest wrong bits, its corners from its upper left one; None if it has more
        wrong bits than the family corrects, or if the contrast or the border is not a tag's.
    """
    start = (code.total_width - code.width_at_border) // 2
    size = code.width_at_border + 2
    square = code.width_at_border * np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    transform = cv2.getPerspectiveTransform(square, corners.astype(np.float32))
    reach = code.total_width if not code.dark_inside else size
    origin = -start if not code.dark_inside else -1
    middles = np.arange(reach) + origin + 0.5
    probes = np.array([[0.0, 0.0], [0.2, 0.2], [-0.2, 0.2], [-0.2, -0.2], [0.2, -0.2]])
    cells = np.stack(np.meshgrid(middles, middles), axis=-1).reshape(-1, 1, 2) + probes
    where = cv2.perspectiveTransform(cells.reshape(1, -1, 2), transform)
    remap: Any = cv2.remap
    grey = remap(
        image, where.astype(np.float32), None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    grey = grey.reshape(reach, reach, len(probes)).astype(np.float32).mean(axis=-1)
    kernel = np.ones((_THRESHOLD_WINDOW_CELLS, _THRESHOLD_WINDOW_CELLS), np.uint8)
    light, dark = cv2.dilate(grey, kernel), cv2.erode(grey, kernel)
    if float(np.median(light - dark)) < _LEAST_DECODED_CONTRAST_GREY:
        return None
    # shadow scales levels: the geometric mean lies below white in shadow and above black in sun
    white = grey > np.sqrt((light + 1.0) * (dark + 1.0))
    # the border's ring has one colour in every orientation of the square
    inner = slice(-origin, -origin + code.width_at_border)
    ring = white[inner, inner].copy()
    ring[1:-1, 1:-1] = not code.dark_inside
    border_fraction = float((ring != code.dark_inside).mean())
    if border_fraction < _LEAST_BORDER_FRACTION:
        return None
    x, y = code.bit_cells.T - origin
    best: tuple[int, int, int] | None = None
    for turn in range(4):
        bits = np.rot90(white, turn)[y, x]
        word = int("".join("1" if bit else "0" for bit in bits), 2)
        wrong = np.bitwise_count(code.code_words ^ np.uint64(word))
        number = int(np.argmin(wrong))
        if best is None or int(wrong[number]) < best[0]:
            best = (int(wrong[number]), number, turn)
    assert best is not None
    if best[0] > CORRECTED_BITS[code.name]:
        return None
    # after `turn` quarter turns anticlockwise, corner number `turn` is the upper left one
    return FoundSquare(best[1], best[0], np.roll(corners, -best[2], axis=0), border_fraction)


LEAST_EDGE_PX: Final = 8.0
"""Shortest edge of a tag that is read, px (chosen: smaller tags against clutter)."""
_LEAST_EXPLAINED_FRACTION: Final = 0.5
"""Smallest fraction of the variance near the edges that the print explains (chosen: tags in bad
light against false tags)."""
_LEAST_CONTRAST_GREY: Final = 5.0
"""Smallest mean contrast of a tag, grey levels of light (chosen: dim tags against noise)."""
_LEAST_BORDER_STEP: Final = 0.1
"""Smallest mean step of the light across the square's sides, as a fraction of the contrast. It
rejects the inside of a border two cells wide, as in kalibr's grids, which reads like a tag
(chosen: blurred tags against such insides)."""
_MAX_WRONG_RIM_CELLS: Final = 1
"""Most wrong cells in the frame around the code (chosen: dirty tags against false ones)."""
_MAX_UNCLEAR_FRACTION: Final = 0.2
"""Largest fraction of wrong or unclear cells in any quarter of the tag (measured: none of 789 tags
in public photographs has more)."""
_LIBRARY_CORNER_SIGMA: Final = (0.3, 0.015)
"""Standard deviation of the library's own corners of a bent tag: the larger of 0.3 px in the image
that was searched, and 0.015 of the shortest edge. Drawn tags bent by up to 8 mm in 150 had their
worst corner 0.6 to 2.5 % of the edge off (measured: tests/vision/tags/test_bent.py)."""
_LEAST_BENT_EXPLAINED: Final = 0.9
"""Smallest fraction of the variance that a plane print explains of a tag on bent paper (chosen:
bent tags against tags with a covered side)."""
_MAX_BENT_WRONG_CELLS: Final = 5
"""Most cells of a bent tag that a plane print reads wrong (chosen: as above)."""
_MAX_BENT_UNCLEAR: Final = 0.25
"""Largest fraction of unclear cells in a quarter of a bent tag (chosen: looser bounds would accept
as many tags with a covered side)."""


def reads_as_tag(fit: TagFit, code: TagFamilyCode) -> bool:
    """Check that a fit is the tag that was asked for.

    Args:
        fit: fit of the tag's edges.
        code: the tag's family.

    Returns:
        True if the print explains the light, the cells read as printed and the border is one
        cell wide.
    """
    if fit.contrast < _LEAST_CONTRAST_GREY or fit.explained_fraction < _LEAST_EXPLAINED_FRACTION:
        return False
    wrong, frame, unclear = fit.reading
    if (
        wrong > CORRECTED_BITS[code.name]
        or frame > _MAX_WRONG_RIM_CELLS
        or unclear > _MAX_UNCLEAR_FRACTION
    ):
        return False
    return fit.relative_border_step >= _LEAST_BORDER_STEP


def refused_tag_may_be_bent(refused_fit: TagFit) -> bool:
    """Check if a refused fit may be of a tag on bent paper.

    Args:
        refused_fit: a fit that `reads_as_tag` refuses.

    Returns:
        True if there is no fit, or one that is nearly good: on bent paper a fit may fail to
        converge, and a converged fit reads cells near the corners wrong.
    """
    wrong, frame, unclear = refused_fit.reading
    near = (
        wrong <= _MAX_BENT_WRONG_CELLS
        and frame <= _MAX_WRONG_RIM_CELLS
        and unclear <= _MAX_BENT_UNCLEAR
    )
    return refused_fit.contrast == 0.0 or (
        near and refused_fit.explained_fraction >= _LEAST_BENT_EXPLAINED
    )


def library_corner_sigma_px(
    image: NDArray[np.uint8], square: FoundSquare, upscaling: float, code: TagFamilyCode
) -> float | None:
    """Standard deviation of the library's own corners of a tag that may be bent.

    Args:
        image: grey levels, shape (height, width).
        square: the tag as the library found it, in the pixels of `image`.
        upscaling: pixels of `image` per pixel of the image that the library searched.
        code: the family.

    Returns:
        Standard deviation, px; None if this is no tag. A tag has no wrong bit, `decode_tag` reads
        the same number, and its family corrects bits: in other families clutter often reads as
        a tag.
    """
    corners, edge = square.corners, shortest_edge(square.corners)
    height, width = image.shape
    # if the image's side cuts a tag, the library moves its corner into the image
    cell = edge / code.width_at_border
    inside = (corners > cell).all() and (corners < (width - cell, height - cell)).all()
    if not inside or edge < LEAST_EDGE_PX or not CORRECTED_BITS[code.name]:
        return None
    read = decode_tag(image, corners, code)
    if square.wrong_bits or read is None or read.id != square.id:
        return None
    sigma = max(_LIBRARY_CORNER_SIGMA[0] * upscaling, _LIBRARY_CORNER_SIGMA[1] * edge)
    # an object that covers part of a side would move its corners
    return sigma if read.border_fraction == 1.0 else max(sigma, 0.5 * cell)


def shortest_edge(corners: NDArray[np.float64]) -> float:
    """Length of the shortest edge between four corners, shape (4, 2), in their unit."""
    a, b, c, d = corners.tolist()
    return min(math.dist(a, b), math.dist(b, c), math.dist(c, d), math.dist(d, a))


_OPENCV_DICTIONARIES: Final = {
    "36h11": cv2.aruco.DICT_APRILTAG_36h11,
    "36h10": cv2.aruco.DICT_APRILTAG_36h10,
    "25h9": cv2.aruco.DICT_APRILTAG_25h9,
    "16h5": cv2.aruco.DICT_APRILTAG_16h5,
}
"""Families that OpenCV searches for as well; its adaptive threshold finds other tags."""
_SEARCH_STEPS: Final = (8, 8, 8)
"""Most Gauss-Newton steps in each of the three stages of a fit in a search. More steps do not help
fits that do not converge: of 59 drawn tags bent by 4 to 7 mm in 150, 55 converge with these, and
56 with 30 in each stage (measured: tests/vision/tags/test_bent.py)."""
_SEARCH_PIXELS: Final = (400, 4000)
"""Most pixels of a fit in a search: in the first stage, and in each later one (chosen: accuracy
against time)."""
_TRACKED_STEPS: Final = (3, 5, 5)
"""Most steps in each stage of a tracked tag's fit, at camera rate (chosen: convergence against
time)."""
_TRACKED_PIXELS: Final = (120, 240)
"""Most pixels of a tracked tag's fit, as in `_SEARCH_PIXELS` (chosen: accuracy against time)."""
_SECOND_FIT_STEPS: Final = (3, 8, 8)
"""Most steps of the second fit of a tracked tag, after a doubtful first one (chosen: as above)."""
_SECOND_FIT_PIXELS: Final = (200, 800)
"""Most pixels of this second fit, at least, as in `_SEARCH_PIXELS` (chosen: as above)."""
_MAX_PREDICTION_ERROR_PX: Final = 1.0
"""Largest distance of a corner from its prediction, px, at which the first fit of a tracked tag is
accepted; beyond it a second fit follows, with more pixels (chosen: reliability against time)."""
_MAX_TRACKED_SIGMA_PX: Final = 0.06
"""Largest standard deviation of a point, px, at which this first fit is accepted (chosen: as
above)."""
_PIXELS_PER_EDGE_PX: Final = 3.0
"""Pixels of a tracked tag's later stages per pixel of its shortest edge, for large tags (chosen:
accuracy against time)."""
_CUT_MARGIN_CELLS: Final = 0.4
"""Width of the white margin, cells, around a tag cut out close to its border (chosen: closely cut
tags against clutter beside the border)."""
_HALVES_OVERLAP_PX: Final = 48
"""Rows by which each half of the image that is searched by turns reaches beyond the middle; larger
tags are found at half size (chosen: coverage against time)."""


class TagDetector(Detector[AprilTag | TagFamily]):
    """Detects one AprilTag, or all of a family; the measured point is the centre.

    The centre is the print's; on flat paper the diagonals cross there in the undistorted image
    plane.
    """

    def __init__(
        self,
        target: AprilTag | TagFamily,
        camera: Camera | None = None,
        response: CameraResponse | None = None,
    ) -> None:
        super().__init__(target, camera, response)
        self._code = tag_family(target.family)
        self._aruco: Any = None

    def _tag(self, identity: int) -> AprilTag:
        return self.target.tag(identity) if isinstance(self.target, TagFamily) else self.target

    def _wanted(self, squares: list[FoundSquare]) -> list[FoundSquare]:
        if isinstance(self.target, TagFamily):
            return squares
        return [square for square in squares if square.id == self.target.id]

    def _search_half(self, image: NDArray[np.uint8]) -> list[Detection]:
        """Tags that the library finds in the image at half its size."""
        calm = smooth_for_square_search(image)
        if calm is None:
            return []
        small = cv2.resize(calm, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        squares = find_squares(np.asarray(small, np.uint8), self.target.family)
        return self._read(image, squares, 2.0, 0.5)

    def _search_full(
        self, image: NDArray[np.uint8], rows: tuple[int, int] | None = None
    ) -> list[Detection]:
        """Tags that the library finds in the image at full size, or in the given rows of it."""
        if smooth_for_square_search(image) is None:
            return []
        first, end = rows or (0, len(image))
        squares = find_squares(image[first:end], self.target.family)
        return self._read(image, squares, 1.0, (0.0, first))

    def _read(
        self,
        image: NDArray[np.uint8],
        squares: list[FoundSquare],
        scale: float,
        shift: float | tuple[float, float],
    ) -> list[Detection]:
        """Fit the squares, scaled and shifted into the image, and keep those that are tags."""
        found: list[Detection] = []
        for square in self._wanted(squares):
            placed = square._replace(corners=scale * square.corners + shift)
            each, bent = self._fit_several_ways(
                image, placed.corners, placed.id, _SEARCH_STEPS, _SEARCH_PIXELS
            )
            if each is None and bent:
                sigma = library_corner_sigma_px(image, placed, scale, self._code)
                if sigma is not None:
                    each = self._with_library_corners(placed, sigma)
            if each is not None:
                found.append(each)
        return found

    def _with_library_corners(self, square: FoundSquare, sigma: float) -> Detection:
        """Detection with the library's own corners."""
        return Detection(
            self._tag(square.id),
            _crossing(square.corners),
            square.corners,
            np.full(2, sigma / 2.0),  # the mean of four corners
            np.full((4, 2), sigma),
        )

    def _detect_some(self, image: NDArray[np.uint8], way: int | None = None) -> list[Detection]:
        """Search at half and at full size; given `way`, only one of these, by turns.

        Even ways search at half size, odd ones the upper and the lower half at full size.
        """
        if way is None:
            return self._search_half(image) or self._search_full(image)
        if way % 2 == 0:
            return self._search_half(image)
        middle, height = len(image) // 2, len(image)
        rows = (
            (0, middle + _HALVES_OVERLAP_PX)
            if way % 4 == 1
            else (middle - _HALVES_OVERLAP_PX, height)
        )
        return self._search_full(image, (max(rows[0], 0), min(rows[1], height)))

    def _detect_all(self, image: NDArray[np.uint8]) -> list[Detection]:
        found = self._search_full(image) + self._search_half(image)
        found += self._search_opencv(image, found)
        apart: list[Detection] = []
        for each in found:
            if not any(_same(each, other) for other in apart):
                apart.append(each)
        return sorted(apart, key=_by_number)

    def _detect_rest(self, image: NDArray[np.uint8]) -> list[Detection]:
        return self._search_opencv(image, [])

    def _search_opencv(self, image: NDArray[np.uint8], known: list[Detection]) -> list[Detection]:
        """Tags in squares that OpenCV finds, except those that are known."""
        if (
            self.target.family not in _OPENCV_DICTIONARIES
            or smooth_for_square_search(image) is None
        ):
            return []
        if self._aruco is None:
            parameters = cv2.aruco.DetectorParameters()
            parameters.minMarkerPerimeterRate = 0.01
            # the outline of a tag's paper may lie only a cell from the tag's
            parameters.minMarkerDistanceRate = 0.01
            dictionary = cv2.aruco.getPredefinedDictionary(_OPENCV_DICTIONARIES[self.target.family])
            self._aruco = cv2.aruco.ArucoDetector(dictionary, parameters)
        marked, numbers, rejected = self._aruco.detectMarkers(image)
        named = [] if numbers is None else numbers.ravel().tolist()
        out: list[Detection] = []
        for i, quad in enumerate((*marked, *rejected)):
            corners = np.asarray(quad, float).reshape(4, 2)
            if shortest_edge(corners) < LEAST_EDGE_PX:
                continue
            middle = corners.mean(axis=0)
            if any(_covers(each, middle) for each in (*known, *out)):
                continue
            read = decode_tag(image, corners, self._code)
            squares = [] if read is None else [read]
            if i < len(named):  # which corner is the upper left one depends on OpenCV's version
                squares += [FoundSquare(named[i], 0, np.roll(corners, k, axis=0)) for k in (0, 2)]
            for square in self._wanted(squares):
                detection = self._fit_near(image, square.corners, square.id)
                if detection is not None:
                    out.append(detection)
                    break
        return out

    def _detect_in(
        self, image: NDArray[np.uint8], region: tuple[int, int, int, int], predicted: Detection
    ) -> list[Detection]:
        x0, y0, x1, y1 = region
        part = np.ascontiguousarray(image[y0:y1, x0:x1])
        squares = find_squares(part, self.target.family)
        same = [square for square in squares if square.id == _number(predicted)]
        return self._read(image, same, 1.0, (x0, y0))

    def _refined(self, image: NDArray[np.uint8], predicted: Detection) -> Detection | None:
        corners, number = predicted.corners_px, _number(predicted)
        if not np.isfinite(corners).all():
            return None
        first, second = _TRACKED_PIXELS
        most = (
            first,
            min(max(second, int(_PIXELS_PER_EDGE_PX * shortest_edge(corners))), _SEARCH_PIXELS[1]),
        )
        found, fit = self._fit_once(image, corners, number, (0, 0, _TRACKED_STEPS[2]), most)
        if found is not None:
            if (
                fit.max_corner_move_px < _MAX_PREDICTION_ERROR_PX
                and fit.max_sigma_px < _MAX_TRACKED_SIGMA_PX
            ):
                return found
        else:  # the target is not exactly at its prediction
            found = self._fit_near(image, corners, number, _TRACKED_STEPS, most)
        # few pixels may have led the fit astray, or the edge of a shadow lies on the tag
        most = _SECOND_FIT_PIXELS[0], max(_SECOND_FIT_PIXELS[1], most[1])
        if found is None:
            return self._fit_once(image, corners, number, _SECOND_FIT_STEPS, most)[0]
        steps = 0, 0, _SECOND_FIT_STEPS[2]
        surer, _ = self._fit_once(image, found.corners_px, number, steps, most)
        return found if surer is None else surer

    def _fit_near(
        self,
        image: NDArray[np.uint8],
        corners: NDArray[np.float64],
        identity: int,
        steps: tuple[int, int, int] = _SEARCH_STEPS,
        most: tuple[int, int] = _SEARCH_PIXELS,
    ) -> Detection | None:
        """Fit the tag near the given corners; None if it does not read as that tag."""
        return self._fit_several_ways(image, corners, identity, steps, most)[0]

    def _fit_several_ways(
        self,
        image: NDArray[np.uint8],
        corners: NDArray[np.float64],
        identity: int,
        steps: tuple[int, int, int],
        most: tuple[int, int],
    ) -> tuple[Detection | None, bool]:
        """Fit the tag near the given corners in several ways; also True if it may be a bent tag.

        Besides the plain way, the fit is tried without the first stage, which sometimes leads good
        corners astray, and with a narrow quiet zone, for tags cut out closer than a cell.
        """
        ways = [(steps, 1.0)]
        if steps == _SEARCH_STEPS:
            ways.append(((0, *steps[1:]), 1.0))
        if self._code.dark_inside:
            ways.append((steps, _CUT_MARGIN_CELLS))
        bent = True
        for taken, quiet in ways:
            found, fit = self._fit_once(image, corners, identity, taken, most, quiet)
            if found is not None:
                return found, False
            bent = bent and refused_tag_may_be_bent(fit)
        return None, bent

    def _fit_once(
        self,
        image: NDArray[np.uint8],
        corners: NDArray[np.float64],
        identity: int,
        steps: tuple[int, int, int],
        most: tuple[int, int],
        quiet: float = 1.0,
    ) -> tuple[Detection | None, TagFit]:
        """Fit a tag once; the tag if it reads as one, and the fit."""
        code = self._code
        points, sigmas = np.empty((5, 2)), np.empty((5, 2))
        with interrupts.postponed():  # numba crashes if it cannot build the named tuple
            fit = fit_tag(
                image, self._light, self._rays, self._row, _cells_of(code, identity),
                code.width_at_border,
                quiet, steps, most, corners, points, sigmas,
            )  # fmt: skip
        if not reads_as_tag(fit, code):
            return None, fit
        found = Detection(self._tag(identity), points[4], points[:4], sigmas[4], sigmas[:4])
        return found, fit


@lru_cache(maxsize=256)
def _cells_of(code: TagFamilyCode, identity: int) -> NDArray[np.float64]:
    """Printed cells, 0 black to 1 white, nan where nothing is specified."""
    cells = code.cells(identity)
    return np.where(cells == UNPRINTED, np.nan, cells / 255.0)


def _crossing(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Crossing of the diagonals of four corners, px."""
    a, b, c, d = np.column_stack([corners, np.ones(4)])
    point = np.cross(np.cross(a, c), np.cross(b, d))
    return np.asarray(point[:2] / point[2])


def _number(detection: Detection) -> int:
    assert isinstance(detection.target, AprilTag)
    return detection.target.id


def _by_number(detection: Detection) -> tuple[int, float, float]:
    u, v = detection.point_px.tolist()
    return _number(detection), u, v


def _same(a: Detection, b: Detection) -> bool:
    """True if two detections are of one tag."""
    return a.target == b.target and _covers(b, a.point_px)


def _covers(detection: Detection, point: NDArray[np.float64]) -> bool:
    """True if a point, px, lies within a detected tag."""
    corners = detection.corners_px.astype(np.float32)
    return cv2.pointPolygonTest(corners, point.tolist(), measureDist=False) >= 0.0
