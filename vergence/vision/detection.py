"""Detection of planar targets: the result, and the interface of all detectors.

Pixels follow OpenCV: the centre of the upper left pixel is (0, 0).

A detector accepts only targets that it can read: after refinement it compares each cell of the
board with the printed pattern, relative to the grey levels around the cell. For a half-hidden
target it returns None, never a wrong point.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, Final, Generic, NamedTuple, Protocol, TypeVar

import cv2
import numpy as np
from numpy.typing import ArrayLike

from vergence.errors import ConfigurationError
from vergence.models.camera import (
    Camera,
    CameraResponse,
    default_response,
    light_table,
    parse_response,
)
from vergence.models.lens import BROWN_CONRADY, pack_camera
from vergence.models.parts import FloatArray
from vergence.vision.image import has_colour_channels, measurement_channel
from vergence.vision.optics import FlatView, Image, ray_table
from vergence.vision.pose import Pose, View, estimate_pose
from vergence.vision.targets import AprilTag, PlanarTarget, TagFamily, Target

_REGION_MARGIN_SHARE: Final = 0.5
"""Margin of the search region for the board's rim, as a fraction of the distance between the
outermost corners (chosen: targets kept against time)."""
_REGION_MARGIN_PX: Final = 24
"""Further margin, for the prediction error, px (chosen: as above)."""
_LEAST_REGION_PX: Final = 24
"""Smallest side of a search region, px (chosen: time against targets at the image's edge)."""
_UNSTATED_SIGMA_PX: Final = 0.1
"""Standard deviation of a corner in a pose if its detector states none, px (chosen: that of heads
made from calibrations)."""
_NO_RAYS = np.zeros((0, 0, 2), np.float32)
_NO_RAYS.setflags(write=False)  # read-only like tables of rays, so that kernels compile only once
_NO_CAMERA = pack_camera((1, 1), np.ones(2), np.zeros(2), BROWN_CONRADY, np.zeros(5))

TargetT = TypeVar("TargetT", bound=Target)


class Detection(NamedTuple):
    """Something found in an image: what a detector of one's own returns, see `Detector`."""

    pixel: Any
    """(2,) pixel (u, v)."""
    sigma_px: Any = 1.0
    """Standard deviation of u and v, px; one number or two."""
    id: Any = None
    """Name that it keeps from image to image, such as a person's number; None if it has none."""
    score: float = 1.0
    """Confidence; of several the highest becomes the target."""
    pose: Any = None
    """Pose T_C_T in the camera; None if unknown."""
    size_px: float | None = None
    """Its width in the image, px, by which both eyes and later images recognise it; or None."""


class Detector(Protocol):
    """A detector of one's own; the name of its class is a target's name, `mine.py:Class`.

    The class is made for each eye, with `camera` (a `Camera`) if its `__init__` takes that. With
    `both_eyes = True` it is made once, and gets two images and two hints, and returns two lists. It
    may state `latency_s` and `rate_hz`: so a simulation delays it; a robot measures them.
    """

    def detect(self, image: Any, hint: Any) -> Sequence[Detection]:
        """Find all candidates in an image.

        Args:
            image: (height, width, 3) uint8, blue, green and red as in OpenCV.
            hint: (2,) pixel at which the target is expected; None before it is found.
        """


class BoardDetection(NamedTuple):
    """A detected target in an image."""

    target: PlanarTarget
    """The target found: one tag of a family; a ChArUco board with the layout found."""
    point_px: FloatArray
    """The measured point, (u, v), shape (2,)."""
    corners_px: FloatArray
    """Corners in the order of the target's ``corners_m``, shape (n, 2); nan for undetected corners
    of a ChArUco board or an AprilGrid."""
    sigma_px: FloatArray
    """Standard deviations of the measured point's u and v, shape (2,)."""
    corners_sigma_px: FloatArray
    """Standard deviations of the corners, shape (n, 2); nan as in `corners_px`."""
    corners_covariance_px2: FloatArray | None = None
    """Covariance of the corners' coordinates u_0, v_0, u_1, ..., shape (2 n, 2 n), px^2; None if
    their errors are independent."""
    camera: Camera | None = None
    """The detector's camera."""

    @property
    def pixel(self) -> FloatArray:
        """The measured point, see `Detection`."""
        return self.point_px

    @property
    def id(self) -> int | None:
        """A tag's number; None for a board."""
        return self.target.id if isinstance(self.target, AprilTag) else None

    @property
    def score(self) -> float:
        """1: what is read is certain, see `Detection`."""
        return 1.0

    @property
    def pose(self) -> Pose | None:
        """Pose T_C_T of the target in its camera, computed anew each time.

        It has the second solution where two tilts fit the corners. For a target of unknown size
        (`size_known`), rotation and direction hold, and lengths are proportional to the assumed
        size. None if the corners do not determine it.

        Raises:
            ConfigurationError: the detector was made without a camera.
        """
        if self.camera is None:
            raise ConfigurationError(
                "pose: expected a detector made with a camera and its lens model, as by "
                "make_detector(target, camera), got one without"
            )
        view = View(self.camera, self.corners_px, corner_noise(self))
        return estimate_pose(self.target.corners_m, [view])


def corner_noise(found: BoardDetection, unstated_px: float = 0.0) -> FloatArray:
    """Noise of a detection's corners, see `View`, with a sigma, px, for those that state none."""
    unstated_px = unstated_px or _UNSTATED_SIGMA_PX
    if found.corners_covariance_px2 is not None:
        return found.corners_covariance_px2
    return np.where(found.corners_sigma_px > 0.0, found.corners_sigma_px, unstated_px)


class Frame(NamedTuple):
    """An image as it is measured."""

    grey: Image  # (height, width) levels
    light: FloatArray  # (256,) light of each level, see `light_table`


Region = tuple[int, int, int, int]
"""Part x0 <= u < x1, y0 <= v < y1 of an image, (x0, y0, x1, y1)."""


class Part(NamedTuple):
    """A region of an image, resized."""

    image: Image
    scale: float
    corner: tuple[int, int]  # the region's upper left pixel

    def in_whole(self, pixels: ArrayLike) -> FloatArray:
        """Pixels (..., 2) of the whole image for those of the part."""
        return (np.asarray(pixels, float) + 0.5) / self.scale - 0.5 + self.corner


def cut_out(
    image: Image, region: Region | None = None, scale: float = 1.0, most_px: float = np.inf
) -> Part:
    """Region of an image, None for all of it, resized, the longer side to a length at most."""
    x0, y0, x1, y1 = region or (0, 0, image.shape[1], image.shape[0])
    part = np.ascontiguousarray(image[y0:y1, x0:x1])
    scale = min(scale, most_px / max(part.shape))
    if scale != 1.0:
        method = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_CUBIC
        part = np.asarray(cv2.resize(part, None, None, scale, scale, method), np.uint8)
    return Part(part, scale, (x0, y0))


class BoardDetector(ABC, Generic[TargetT]):
    """Base class of detectors, which find a target in images of one eye.

    A detector keeps nothing of an image, and may be used by several threads at once.

    Attributes:
        target: target to find.
        camera: the eye, for its lens model and the size that images must have; None for a pinhole
            and images of any size.
        response: response curve (light by grey level), since edges are fitted in light, see
            `parse_response`; None if neither the caller nor the camera gives one. Then it depends
            on whether an image has colours, see `default_response`.
    """

    def __init__(
        self, target: TargetT, camera: Camera | None = None, response: CameraResponse | None = None
    ) -> None:
        self.target = target
        self.camera = camera
        if response is None and camera is not None:
            response = camera.response
        self.response = None if response is None else parse_response(response)
        self._lens = lens = camera if camera is not None and camera.distorts else None
        self._rays = _NO_RAYS if lens is None else ray_table(lens, 1, 0)
        self._row = _NO_CAMERA if lens is None else lens.row
        self._size = None if camera is None else (camera.width, camera.height)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the arguments alone: the rest of the state cannot be pickled."""
        of_camera = None if self.camera is None else self.camera.response
        own = () if self.response == of_camera else (self.response,)
        return type(self), (self.target, self.camera, *own)

    def detect_all(self, image: ArrayLike) -> list[BoardDetection]:
        """Find all targets in an image by an exhaustive search, without regard to time.

        Args:
            image: an image in any form that `as_grey` accepts.

        Returns:
            The detections, tags ordered by number; a board is found at most once.

        Raises:
            ConfigurationError: the image is invalid, or not of the camera's size.
        """
        return self._detect_all(self._frame(image))

    def detect(self, image: ArrayLike, near_px: ArrayLike | None = None) -> BoardDetection | None:
        """Search a whole image, first by quick methods and, if these find nothing, exhaustively.

        Args:
            image: an image in any form that `as_grey` accepts.
            near_px: (2,) expected position; of several detections the nearest is returned, or the
                largest if this is None.

        Returns:
            The detection; None if no target can be read.

        Raises:
            ConfigurationError: the image is invalid, or not of the camera's size; `near_px` is
                not a pixel.
        """
        frame = self._frame(image)
        near = None if near_px is None else as_pixel("near_px", near_px)
        return _choose(self._detect_some(frame) or self._detect_rest(frame), near)

    def search(
        self, image: ArrayLike, near_px: ArrayLike | None = None, way: int | None = None
    ) -> BoardDetection | None:
        """Search a whole image by the quick methods alone, for loops at camera rate.

        Args:
            image: see `detect`.
            near_px: see `detect`.
            way: number of a single method, any integer (they repeat in turn), to search for a
                lost target by one method per image; None for all methods.

        Returns:
            See `detect`.

        Raises:
            ConfigurationError: see `detect`; `way` is not an integer.
        """
        near = None if near_px is None else as_pixel("near_px", near_px)
        if way is not None and not isinstance(way, int | np.integer):
            raise ConfigurationError(f"way: expected a whole number or None, got {way!r:.80}")
        return _choose(self._detect_some(self._frame(image), way), near)

    def track(self, image: ArrayLike, predicted: BoardDetection) -> BoardDetection | None:
        """Search for the target only near its predicted position.

        The predicted corners are refined; if that fails, a region of the target's size with a
        margin is searched.

        Args:
            image: an image in any form that `as_grey` accepts.
            predicted: an earlier detection with its point and corners moved to the predicted
                pixels.

        Returns:
            The detection; None if no target can be read.

        Raises:
            ConfigurationError: the image is invalid, or not of the camera's size; the prediction
                is not a detection of this target.
        """
        frame = self._frame(image)
        self._check(predicted)
        found = self._refined(frame, predicted)
        if found is not None:
            return found
        known = predicted.corners_px[np.isfinite(predicted.corners_px).all(axis=1)]
        if not len(known):
            return None
        low, high = known.min(axis=0), known.max(axis=0)
        margin = _REGION_MARGIN_SHARE * float((high - low).max()) + _REGION_MARGIN_PX
        outline = np.concatenate([np.floor(low - margin), np.ceil(high + margin) + 1])
        x0, y0, x1, y1 = np.clip(outline, 0, 2 * frame.grey.shape[::-1]).astype(int).tolist()
        if min(x1 - x0, y1 - y0) < _LEAST_REGION_PX:
            return None
        return _choose(self._detect_in(frame, (x0, y0, x1, y1), predicted), predicted.point_px)

    def response_of(self, image: ArrayLike) -> CameraResponse:
        """Response used for an image: the stated one, or the default for grey or colour images."""
        if self.response is not None:
            return self.response
        return default_response(colour=has_colour_channels(image))

    def _frame(self, image: ArrayLike) -> Frame:
        light = light_table(self.response_of(image))
        return Frame(measurement_channel(image, self._size), light)

    def _check(self, predicted: BoardDetection) -> None:
        target = getattr(predicted, "target", None)
        kind = AprilTag if isinstance(self.target, TagFamily) else type(self.target)
        if not isinstance(target, kind):
            raise ConfigurationError(
                f"predicted: expected a detection of {self.target}, got {predicted!r:.80}"
            )
        corners, expected = np.shape(predicted.corners_px), target.corners_m.shape
        if corners != expected:
            raise ConfigurationError(
                f"predicted: expected corners_px of shape {expected}, got {corners}"
            )

    def _flat(self, pixels: FloatArray) -> FlatView:
        """Undistorted plane around some pixels."""
        return FlatView(self._lens, pixels)

    @abstractmethod
    def _detect_all(self, frame: Frame) -> list[BoardDetection]:
        """Find all targets."""

    @abstractmethod
    def _detect_some(self, frame: Frame, way: int | None = None) -> list[BoardDetection]:
        """Find targets by the quick methods, or by the single method of a number."""

    def _detect_rest(self, frame: Frame) -> list[BoardDetection]:
        """Find all targets after the quick methods have found none."""
        return self._detect_all(frame)

    @abstractmethod
    def _detect_in(
        self, frame: Frame, region: Region, predicted: BoardDetection
    ) -> list[BoardDetection]:
        """Search a region for a predicted target."""

    @abstractmethod
    def _refined(self, frame: Frame, predicted: BoardDetection) -> BoardDetection | None:
        """Refine predicted corners; None if the target is not there."""


def as_pixel(name: str, value: ArrayLike) -> FloatArray:
    """Pixel (u, v) from a value of a name; `ConfigurationError` if it is none, or not finite."""
    try:
        pixel = np.asarray(value, float)
    except (TypeError, ValueError):
        pixel = np.empty(0)
    if pixel.shape != (2,) or not np.isfinite(pixel).all():
        raise ConfigurationError(f"{name}: expected a pixel (u, v), got {value!r:.80}")
    return pixel


def _choose(found: Sequence[BoardDetection], near_px: FloatArray | None) -> BoardDetection | None:
    """Detection nearest to a pixel, or the largest if there is none."""
    if len(found) < 2:
        return found[0] if found else None
    if near_px is None:
        return max(found, key=lambda each: float(np.nanmean(np.ptp(each.corners_px, axis=0))))
    return min(found, key=lambda each: float(np.linalg.norm(each.point_px - near_px)))
