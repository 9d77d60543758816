"""Detection of AprilTags: decoding, fit of all edges, and acceptance."""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence import interrupts
from vergence.models.camera import Camera, CameraResponse
from vergence.vision.detection import BoardDetection, BoardDetector, Frame, Region, cut_out
from vergence.vision.image import smooth_for_square_search
from vergence.vision.tag_families import (
    CORRECTED_BITS,
    UNPRINTED,
    FoundSquare,
    TagFamilyCode,
    find_squares,
    tag_family,
)
from vergence.vision.tags.fit import LEAST_EDGE_PX, FitEffort, TagFit, fit_tag
from vergence.vision.tags.samples import ALL, NARROW, WIDE
from vergence.vision.targets import AprilTag, TagFamily

_THRESHOLD_WINDOW_CELLS: Final = 5
"""Side, in cells, of the window around a cell whose lightest and darkest cell give its threshold
(chosen: both colours in the window against shadows within it)."""
_LEAST_DECODED_CONTRAST_GREY: Final = 8.0
"""Smallest median contrast within these windows, grey levels (chosen: dim tags against clutter)."""
_LEAST_BORDER_FRACTION: Final = 0.8
"""Smallest fraction of the border's cells that have its colour (chosen: covered tags against
clutter)."""


def _decode_tag(
    image: NDArray[np.uint8], corners: NDArray[np.float64], code: TagFamilyCode
) -> FoundSquare | None:
    """Decode a square with corners in order around it, (4, 2) px; None if it is no tag of a family.

    The libraries fit one plane of grey levels to the whole square; the local thresholds used here
    also read a square in which a shadow ends. Corners of the tag begin at its upper left one.
    """
    margin = 1 if code.dark_inside else (code.total_width - code.width_at_border) // 2
    reach = code.width_at_border + 2 * margin
    square = code.width_at_border * np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    transform = cv2.getPerspectiveTransform(square, corners.astype(np.float32))
    middles = np.arange(reach) - margin + 0.5
    probes = np.array([[0.0, 0.0], [0.2, 0.2], [-0.2, 0.2], [-0.2, -0.2], [0.2, -0.2]])
    cells = np.stack(np.meshgrid(middles, middles), axis=-1).reshape(-1, 1, 2) + probes
    where = cv2.perspectiveTransform(cells.reshape(1, -1, 2), transform)
    remap: Any = cv2.remap
    grey = remap(
        image, where.astype(np.float32), None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    grey = grey.reshape(reach, reach, len(probes)).astype(np.float32).mean(axis=-1)
    kernel = np.ones(2 * (_THRESHOLD_WINDOW_CELLS,), np.uint8)
    light, dark = cv2.dilate(grey, kernel), cv2.erode(grey, kernel)
    if float(np.median(light - dark)) < _LEAST_DECODED_CONTRAST_GREY:
        return None
    # shadow scales levels: the geometric mean lies below white in shadow and above black in sun
    white = grey > np.sqrt((light + 1.0) * (dark + 1.0))
    # the border's ring has one colour in every orientation of the square
    inner = slice(margin, margin + code.width_at_border)
    ring = white[inner, inner].copy()
    ring[1:-1, 1:-1] = not code.dark_inside
    border_fraction = float((ring != code.dark_inside).mean())
    if border_fraction < _LEAST_BORDER_FRACTION:
        return None
    x, y = code.bit_cells.T + margin
    readings = []
    for turn in range(4):
        bits = np.rot90(white, turn)[y, x]
        word = int("".join("1" if bit else "0" for bit in bits), 2)
        wrong = np.bitwise_count(code.code_words ^ np.uint64(word))
        number = int(np.argmin(wrong))
        readings.append((int(wrong[number]), turn, number))
    wrong_bits, turn, number = min(readings)
    if wrong_bits > CORRECTED_BITS[code.name]:
        return None
    # after `turn` quarter turns anticlockwise, corner number `turn` is the upper left one
    return FoundSquare(number, wrong_bits, np.roll(corners, -turn, axis=0), border_fraction)


_LEAST_EXPLAINED_FRACTION: Final = 0.5
"""Smallest fraction of the variance near the edges that the print explains (chosen: tags in bad
light against false tags)."""
_LEAST_MEAN_CONTRAST: Final = 5.0
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


def _reads_as_tag(fit: TagFit, code: TagFamilyCode) -> bool:
    """True if the print explains the light, cells read as printed, the border is a cell wide."""
    wrong, frame, unclear = fit.reading
    return (
        fit.contrast >= _LEAST_MEAN_CONTRAST
        and fit.explained_fraction >= _LEAST_EXPLAINED_FRACTION
        and wrong <= CORRECTED_BITS[code.name]
        and frame <= _MAX_WRONG_RIM_CELLS
        and unclear <= _MAX_UNCLEAR_FRACTION
        and fit.relative_border_step >= _LEAST_BORDER_STEP
    )


def _refused_tag_may_be_bent(refused_fit: TagFit) -> bool:
    """True if there is no fit, as on bent paper, or one that reads only some cells there wrong."""
    wrong, frame, unclear = refused_fit.reading
    return refused_fit.contrast == 0.0 or (
        wrong <= _MAX_BENT_WRONG_CELLS
        and frame <= _MAX_WRONG_RIM_CELLS
        and unclear <= _MAX_BENT_UNCLEAR
        and refused_fit.explained_fraction >= _LEAST_BENT_EXPLAINED
    )


def _shortest_edge(corners: NDArray[np.float64]) -> float:
    """Length of the shortest edge between four corners, shape (4, 2), in their unit."""
    a, b, c, d = corners.tolist()
    return min(math.dist(a, b), math.dist(b, c), math.dist(c, d), math.dist(d, a))


_SEARCH: Final = FitEffort(WIDE, wide_steps=8, steps=8, wide_pixels=400, pixels=4000)
"""Fit in a search (chosen: accuracy against time). More steps do not help fits that do not
converge: of 59 drawn tags bent by 4 to 7 mm in 150, 55 converge with these, and 56 with 30 in each
stage (measured: tests/vision/tags/test_bent.py)."""
_SEARCHES: Final = (_SEARCH, _SEARCH._replace(first_stage=NARROW))
"""Fits in a search, by turns: the first stage sometimes leads good corners astray."""
_TRACKED: Final = FitEffort(WIDE, wide_steps=3, steps=5, wide_pixels=120, pixels=240)
"""Fit of a tracked tag, at camera rate (chosen: convergence and accuracy against time)."""
_SECOND: Final = FitEffort(WIDE, wide_steps=3, steps=8, wide_pixels=200, pixels=800)
"""Second fit of a tracked tag, after a doubtful first one; these are its fewest pixels (chosen: as
above)."""
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


class TagDetector(BoardDetector[AprilTag | TagFamily]):
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

    def _tag(self, identity: int) -> AprilTag:
        return self.target.tag(identity) if isinstance(self.target, TagFamily) else self.target

    def _wanted(self, squares: list[FoundSquare]) -> list[FoundSquare]:
        if isinstance(self.target, TagFamily):
            return squares
        return [square for square in squares if square.id == self.target.id]

    def _search_half(self, frame: Frame) -> list[BoardDetection]:
        """Tags that the library finds in the image at half its size."""
        calm = smooth_for_square_search(frame.grey)
        if calm is None:
            return []
        small = cv2.resize(calm, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        return self._read(frame, np.asarray(small), 2.0, 0.5)

    def _search_full(
        self, frame: Frame, first: int = 0, end: int | None = None
    ) -> list[BoardDetection]:
        """Tags that the library finds at full size in the given rows of the image."""
        if smooth_for_square_search(frame.grey) is None:
            return []
        return self._read(frame, frame.grey[first:end], 1.0, (0, first))

    def _read(
        self, frame: Frame, searched: NDArray[np.uint8], scale: float,
        shift: float | tuple[int, int], number: int | None = None,
    ) -> list[BoardDetection]:  # fmt: skip
        """Tags, or those of a number, in a part of the frame, or a smaller one: fitted and kept.

        Scale and shift lead from its pixels to the frame's.
        """
        found: list[BoardDetection] = []
        for square in self._wanted(find_squares(searched, self.target.family)):
            if number not in (None, square.id):
                continue
            placed = square._replace(corners=scale * square.corners + shift)
            each, bent = self._fit_several_ways(frame, placed.corners, placed.id)
            if each is None and bent:
                each = self._bent(frame, placed, scale)
            if each is not None:
                found.append(each)
        return found

    def _bent(self, frame: Frame, square: FoundSquare, upscaling: float) -> BoardDetection | None:
        """Tag that may be bent, with the library's own corners and their sigma; None if doubtful.

        A tag has no wrong bit, `_decode_tag` reads the same number, and its family corrects bits:
        in other families clutter often reads as a tag.
        """
        corners, edge = square.corners, _shortest_edge(square.corners)
        height, width = frame.grey.shape
        # if the image's side cuts a tag, the library moves its corner into the image
        cell = edge / self._code.width_at_border
        inside = (corners > cell).all() and (corners < (width - cell, height - cell)).all()
        sure = square.wrong_bits == 0 < CORRECTED_BITS[self._code.name]
        if not (inside and sure) or edge < LEAST_EDGE_PX:
            return None
        read = _decode_tag(frame.grey, corners, self._code)
        if read is None or read.id != square.id:
            return None
        sigma = max(_LIBRARY_CORNER_SIGMA[0] * upscaling, _LIBRARY_CORNER_SIGMA[1] * edge)
        if read.border_fraction < 1.0:  # an object that covers part of a side moves its corners
            sigma = max(sigma, 0.5 * cell)
        # crossing of the diagonals
        a, b, c, d = np.column_stack([corners, np.ones(4)])
        point = np.cross(np.cross(a, c), np.cross(b, d))
        return BoardDetection(
            self._tag(square.id), point[:2] / point[2], corners,
            np.full(2, sigma / 2.0),  # the mean of four corners
            np.full((4, 2), sigma), camera=self.camera,
        )  # fmt: skip

    def _detect_some(self, frame: Frame, way: int | None = None) -> list[BoardDetection]:
        """Search at half and at full size; given `way`, only one of these, by turns.

        Even ways search at half size, odd ones the upper and the lower half at full size.
        """
        middle = len(frame.grey) // 2
        if way is None:
            return self._search_half(frame) or self._search_full(frame)
        if way % 2 == 0:
            return self._search_half(frame)
        if way % 4 == 1:
            return self._search_full(frame, 0, middle + _HALVES_OVERLAP_PX)
        return self._search_full(frame, max(middle - _HALVES_OVERLAP_PX, 0))

    def _detect_all(self, frame: Frame) -> list[BoardDetection]:
        found = self._search_full(frame) + self._search_half(frame)
        found += self._search_opencv(frame, found)
        apart: list[BoardDetection] = []
        for each in found:
            if not any(each.target == a.target and _covers(a, each.point_px) for a in apart):
                apart.append(each)
        return sorted(apart, key=lambda each: (_number(each), *each.point_px.tolist()))

    def _detect_rest(self, frame: Frame) -> list[BoardDetection]:
        return self._search_opencv(frame, [])

    def _search_opencv(self, frame: Frame, known: list[BoardDetection]) -> list[BoardDetection]:
        """Tags in squares that OpenCV finds by its adaptive threshold, except known ones."""
        family = getattr(cv2.aruco, f"DICT_APRILTAG_{self.target.family}", None)
        if family is None or smooth_for_square_search(frame.grey) is None:
            return []
        parameters = cv2.aruco.DetectorParameters()
        parameters.minMarkerPerimeterRate = 0.01
        # the outline of a tag's paper may lie only a cell from the tag's
        parameters.minMarkerDistanceRate = 0.01
        dictionary = cv2.aruco.getPredefinedDictionary(family)
        found: Any = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(frame.grey)
        marked, numbers, rejected = found
        named = [] if numbers is None else numbers.ravel().tolist()
        out: list[BoardDetection] = []
        for i, quad in enumerate((*marked, *rejected)):
            corners = np.asarray(quad, float).reshape(4, 2)
            if _shortest_edge(corners) < LEAST_EDGE_PX:
                continue
            middle = corners.mean(axis=0)
            if any(_covers(each, middle) for each in (*known, *out)):
                continue
            read = _decode_tag(frame.grey, corners, self._code)
            squares = [] if read is None else [read]
            if i < len(named):  # which corner is the upper left one depends on OpenCV's version
                squares += [FoundSquare(named[i], 0, np.roll(corners, k, axis=0)) for k in (0, 2)]
            for square in self._wanted(squares):
                detection, _ = self._fit_several_ways(frame, square.corners, square.id)
                if detection is not None:
                    out.append(detection)
                    break
        return out

    def _detect_in(
        self, frame: Frame, region: Region, predicted: BoardDetection
    ) -> list[BoardDetection]:
        part = cut_out(frame.grey, region)
        return self._read(frame, part.image, 1.0, part.corner, _number(predicted))

    def _refined(self, frame: Frame, predicted: BoardDetection) -> BoardDetection | None:
        corners, number = predicted.corners_px, _number(predicted)
        if not np.isfinite(corners).all():
            return None
        most = max(_TRACKED.pixels, int(_PIXELS_PER_EDGE_PX * _shortest_edge(corners)))
        effort = _TRACKED._replace(first_stage=ALL, pixels=min(most, _SEARCH.pixels))
        found, fit = self._fit_once(frame, corners, number, effort)
        near = fit.max_corner_move_px < _MAX_PREDICTION_ERROR_PX
        if found is not None and near and fit.max_sigma_px < _MAX_TRACKED_SIGMA_PX:
            return found
        if found is None:  # the target is not exactly at its prediction
            effort = effort._replace(first_stage=WIDE)
            found, _ = self._fit_several_ways(frame, corners, number, (effort,))
        # few pixels may have led the fit astray, or the edge of a shadow lies on the tag
        second = _SECOND._replace(pixels=max(_SECOND.pixels, effort.pixels))
        if found is None:
            return self._fit_once(frame, corners, number, second)[0]
        second = second._replace(first_stage=ALL)
        return self._fit_once(frame, found.corners_px, number, second)[0] or found

    def _fit_several_ways(
        self, frame: Frame, corners: NDArray[np.float64], identity: int,
        efforts: Sequence[FitEffort] = _SEARCHES,
    ) -> tuple[BoardDetection | None, bool]:  # fmt: skip
        """Fit the tag near the given corners in several ways; also True if it may be a bent tag."""
        ways = [(effort, 1.0) for effort in efforts]
        if self._code.dark_inside:  # may be cut out closer than a cell
            ways.append((efforts[0], _CUT_MARGIN_CELLS))
        bent = True
        for effort, quiet in ways:
            found, fit = self._fit_once(frame, corners, identity, effort, quiet)
            if found is not None:
                return found, False
            bent = bent and _refused_tag_may_be_bent(fit)
        return None, bent

    def _fit_once(
        self, frame: Frame, corners: NDArray[np.float64], identity: int, effort: FitEffort,
        quiet: float = 1.0,
    ) -> tuple[BoardDetection | None, TagFit]:  # fmt: skip
        """Fit a tag once; the tag if it reads as one, and the fit."""
        code = self._code
        points, sigmas, covariance = np.empty((5, 2)), np.empty((5, 2)), np.empty((8, 8))
        with interrupts.postponed():  # numba crashes if it cannot build the named tuple
            fit = fit_tag(
                *frame, self._rays, self._row, _cells_of(code, identity),
                code.width_at_border, quiet, *effort, corners, points, sigmas, covariance,
            )  # fmt: skip
        if not _reads_as_tag(fit, code):
            return None, fit
        found = BoardDetection(
            self._tag(identity), points[4], points[:4], sigmas[4], sigmas[:4], covariance,
            self.camera,
        )  # fmt: skip
        return found, fit


@lru_cache(maxsize=256)
def _cells_of(code: TagFamilyCode, identity: int) -> NDArray[np.float64]:
    """Printed cells, 0 black to 1 white, nan where nothing is specified."""
    cells = code.cells(identity)
    return np.where(cells == UNPRINTED, np.nan, cells / 255.0)


def _number(detection: BoardDetection) -> int:
    assert isinstance(detection.target, AprilTag)
    return detection.target.id


def _covers(detection: BoardDetection, point: NDArray[np.float64]) -> bool:
    """True if a point, px, lies within a detected tag."""
    corners = detection.corners_px.astype(np.float32)
    return cv2.pointPolygonTest(corners, point.tolist(), measureDist=False) >= 0.0
