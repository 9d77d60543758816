"""AprilTag detectors behind one interface, in coordinates with integer pixel centres.

The AprilTag library, and so all its bindings, has its origin at the corner of the upper left pixel;
half a pixel is subtracted here. OpenCV's refinement `CORNER_REFINE_APRILTAG` copied that code with
its origin, so half a pixel is subtracted as well; OpenCV's other corners need no correction.
Measured on drawn tags at known positions: the mean of a tag's corners is off by (0.50, 0.50) px
with the library, by (0.46, 0.45) px with that refinement, by less than 0.02 px with OpenCV's
others.

The packages pyapriltags, pupil-apriltags and dt-apriltags pass `decode_sharpening` through `int`,
so that their default of 0.25 becomes 0; methods ending in ``+sharpening`` set the library's own
default of 0.25. OpenCV rotates the tags of its AprilTag dictionaries relative to the library's, so
that the order of corners of other methods has no meaning; see `Found`.
"""

import importlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.tag_images.photographs import LIBRARY_OFFSET_PX, crossing

Image = NDArray[np.uint8]
_SHARPENING = 0.25


@dataclass(frozen=True)
class Found:
    """A tag detected by a method."""

    id: int
    centre_px: NDArray[np.float64]
    """Shape (2,)."""
    corners_px: NDArray[np.float64]
    """In the method's own order, shape (4, 2)."""
    wrong_bits: int = 0
    """Number of corrected bits, if the method states it."""
    margin: float | None = None
    """Mean distance of its bits from the threshold, grey levels; None if not stated."""


Detect = Callable[[Image], list[Found]]


@dataclass(frozen=True)
class Method:
    """A detector."""

    name: str
    voter: str
    """Name of the shared vote; methods that run the same code have one vote together."""
    detect: Detect
    refined: bool = True
    """True if corners have sub-pixel accuracy, so that the method may vote."""
    ordered: bool = False
    """True if corners come as upper left, upper right, lower right, lower left."""


def _vergence(family: str) -> Detect:
    vision: Any = importlib.import_module("vergence.vision")
    if not hasattr(vision, "parse_target"):
        raise ImportError("this vergence cannot parse targets")
    detector = vision.make_detector(vision.parse_target(f"tag:{family}"))
    return lambda image: [
        Found(seen.target.id, np.asarray(seen.point_px), np.asarray(seen.corners_px))
        for seen in detector.detect_all(image)
    ]


def _binding(package: str, sharpening: float | None = None) -> Callable[[str], Detect]:
    def make(family: str) -> Detect:
        detector: Any = importlib.import_module(package).Detector(
            families=f"tag{family}", nthreads=1, quad_decimate=1.0
        )
        if sharpening is not None:
            detector.tag_detector_ptr.contents.decode_sharpening = sharpening
        return lambda image: [
            Found(
                seen.tag_id,
                seen.center - LIBRARY_OFFSET_PX,
                seen.corners - LIBRARY_OFFSET_PX,
                seen.hamming,
                seen.decision_margin,
            )
            for seen in detector.detect(image)
        ]

    return make


def _apriltag_python(family: str) -> Detect:
    detector: Any = importlib.import_module("apriltag").apriltag(
        f"tag{family}", threads=1, decimate=1.0
    )
    return lambda image: [
        Found(
            int(seen["id"]),
            np.asarray(seen["center"]) - LIBRARY_OFFSET_PX,
            np.asarray(seen["lb-rb-rt-lt"]) - LIBRARY_OFFSET_PX,
        )
        for seen in detector.detect(image)
    ]


def _aruco(refinement: int | None, offset_px: float) -> Callable[[str], Detect]:
    def make(family: str) -> Detect:
        number: int | None = getattr(cv2.aruco, f"DICT_APRILTAG_{family}", None)
        if number is None:
            raise ImportError(f"OpenCV has no dictionary of {family}")
        parameters = cv2.aruco.DetectorParameters()
        if refinement is not None:
            parameters.cornerRefinementMethod = refinement
        detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(number), parameters)

        def detect(image: Image) -> list[Found]:
            quads, ids, _ = detector.detectMarkers(image)
            corners = [np.asarray(quad[0], dtype=float) - offset_px for quad in quads]
            # ids is None if no marker is found, contrary to its type
            numbers = [int(number) for number in np.ravel(ids)] if quads else []
            return [
                Found(number, crossing(quad), quad)
                for number, quad in zip(numbers, corners, strict=True)
            ]

        return detect

    return make


_MAKERS: dict[str, tuple[str, Callable[[str], Detect]]] = {
    "vergence": ("vergence", _vergence),
    "apriltag-python": ("library", _apriltag_python),
    "pyapriltags": ("library", _binding("pyapriltags")),
    "pyapriltags+sharpening": ("library", _binding("pyapriltags", _SHARPENING)),
    "pupil-apriltags": ("library", _binding("pupil_apriltags")),
    "pupil-apriltags+sharpening": ("library", _binding("pupil_apriltags", _SHARPENING)),
    "dt-apriltags": ("library", _binding("dt_apriltags")),
    "aruco": ("aruco", _aruco(None, 0.0)),
    "aruco-apriltag": (
        "aruco-apriltag",
        _aruco(cv2.aruco.CORNER_REFINE_APRILTAG, LIBRARY_OFFSET_PX),
    ),
}
METHODS = tuple(_MAKERS)
"""Names of all methods, in the order of the table."""


def make_methods(names: Iterable[str], family: str, say: Callable[[str], None]) -> list[Method]:
    """Methods whose packages are installed.

    Args:
        names: names from `METHODS`.
        family: family of the tags, such as 36h11.
        say: receives a message for each method that is left out, with the reason.
    """
    methods = []
    for name in names:
        voter, make = _MAKERS[name]
        try:
            method = Method(
                name, voter, make(family), refined=name != "aruco", ordered=name == "vergence"
            )
            methods.append(method)
        except ImportError as error:
            say(f"{name} is left out: {error}")
    return methods
