"""Detecting a planar target: what a detection is, and what a detector does.

Pixels follow OpenCV: the centre of the upper left pixel is (0, 0).

A detector accepts only what it can read: after refinement the cells of the board are compared with
what is printed there, each by the levels around it. A target that is half hidden is None, never a
wrong point.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError
from vergence.models.boards import AprilTag, PlanarTarget, TagFamily, Target
from vergence.models.cameras import BROWN_CONRADY
from vergence.models.packed import pack_camera
from vergence.models.response import (
    Response,
    default_response,
    light_of_levels,
    parse_response,
)
from vergence.vision.image import has_colours, measured_levels
from vergence.vision.optics import EyeCamera, FlatView, NoLens, ray_table

_REGION_MARGIN_SHARE = 0.5
_REGION_MARGIN_PX = 24
"""Margin of the tracked region around the outermost corners: so much of the board's size, for its
rim, and so much for an error of prediction."""
_LEAST_REGION_PX = 24
_NO_RAYS = np.zeros((0, 0, 2), np.float32)
_NO_RAYS.setflags(write=False)  # as tables of rays are: kernels are compiled for one kind
_NO_LENS = NoLens()
_NO_CAMERA = pack_camera((1, 1), np.ones(2), np.zeros(2), BROWN_CONRADY, np.zeros(5))

TargetT = TypeVar("TargetT", bound=Target)


class Detection(NamedTuple):
    """Where a target is in an image."""

    target: PlanarTarget
    """What was found: of a family, one tag; of a ChArUco board, the layout that it has."""
    point_px: NDArray[np.float64]
    """The measured point, (u, v), shape (2,)."""
    corners_px: NDArray[np.float64]
    """Its corners in the order of the target's ``corners_m``, shape (n, 2); nan for those of a
    ChArUco board or an AprilGrid that were not found."""
    sigma_px: NDArray[np.float64]
    """Standard deviations of the measured point's u and v, shape (2,)."""
    corners_sigma_px: NDArray[np.float64]
    """Standard deviations of the corners, shape (n, 2); nan as in `corners_px`."""


class Detector(ABC, Generic[TargetT]):
    """Finds a target in images of one eye.

    Attributes:
        target: what to look for.
        camera: the eye, whose lens is taken into account and whose size images must have; None for
            a pinhole and images of any size.
        response: light by grey level, which edges are fitted in, see `parse_response`; None where
            neither the caller nor the camera says, and each image by its kind, see
            `default_response`.
    """

    def __init__(
        self,
        target: TargetT,
        camera: EyeCamera | None = None,
        response: Response | None = None,
    ) -> None:
        self.target = target
        self.camera = camera
        if response is None and camera is not None:
            response = camera.response
        self.response = None if response is None else parse_response(response)
        self._light = light_of_levels(self.response or default_response(colour=False))
        lens = camera if camera is not None and camera.distorts else None
        self._lens = lens
        self._rays = _NO_RAYS if lens is None else ray_table(lens, 1, 0)
        self._row = _NO_CAMERA if lens is None else lens.row
        self._size = None if camera is None else (camera.width, camera.height)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as the arguments: what is behind cannot be pickled."""
        of_camera = None if self.camera is None else self.camera.response
        own = () if self.response == of_camera else (self.response,)
        return type(self), (self.target, self.camera, *own)

    def detect_all(self, image: ArrayLike) -> list[Detection]:
        """Find every target of the kind asked for, however long that takes.

        Args:
            image: any that `as_grey` takes.

        Returns:
            The detections, tags by their numbers; a board is found once at most.

        Raises:
            ConfigurationError: this is no image, or not of the camera's size.
        """
        return self._detect_all(self._grey(image))

    def detect(self, image: ArrayLike, near_px: ArrayLike | None = None) -> Detection | None:
        """Search a whole image, by the quick ways first and by all if they find nothing.

        Args:
            image: any that `as_grey` takes.
            near_px: (2,) where it is expected; of several the nearest one is taken, without it the
                largest.

        Returns:
            The detection, or None where there is nothing that can be read.

        Raises:
            ConfigurationError: this is no image, or not of the camera's size; `near_px` is no
                pixel.
        """
        grey = self._grey(image)
        near = None if near_px is None else as_pixel("near_px", near_px)
        return _choose(self._detect_some(grey) or self._detect_rest(grey), near)

    def search(
        self, image: ArrayLike, near_px: ArrayLike | None = None, way: int | None = None
    ) -> Detection | None:
        """Search a whole image by the quick ways alone, as a loop at camera rate has to.

        Args:
            image: see `detect`.
            near_px: see `detect`.
            way: the number of one of them, of which there are as many as one likes: a target that
                is lost is searched by one way an image; None for all of them in turn.

        Returns:
            As `detect`.

        Raises:
            ConfigurationError: as `detect`.
        """
        near = None if near_px is None else as_pixel("near_px", near_px)
        if way is not None and not isinstance(way, int | np.integer):
            raise ConfigurationError(f"way: expected a whole number or None, got {way!r:.80}")
        return _choose(self._detect_some(self._grey(image), way), near)

    def track(self, image: ArrayLike, predicted: Detection) -> Detection | None:
        """Look for the target near where it is predicted only.

        The predicted corners are refined; where that fails, a region as large as the target, with a
        margin, is searched.

        Args:
            image: any that `as_grey` takes.
            predicted: a former detection, its point and corners where they are expected now.

        Returns:
            The detection, or None where there is nothing that can be read.

        Raises:
            ConfigurationError: this is no image, or not of the camera's size; the prediction is no
                detection of such a target.
        """
        grey = self._grey(image)
        self._check(predicted)
        found = self._refined(grey, predicted)
        if found is not None:
            return found
        known = predicted.corners_px[np.isfinite(predicted.corners_px).all(axis=1)]
        if not len(known):
            return None
        low, high = known.min(axis=0), known.max(axis=0)
        margin = _REGION_MARGIN_SHARE * float((high - low).max()) + _REGION_MARGIN_PX
        height, width = grey.shape
        x0, y0 = np.clip(np.floor(low - margin), 0, (width, height)).astype(int).tolist()
        x1, y1 = np.clip(np.ceil(high + margin) + 1, 0, (width, height)).astype(int).tolist()
        if min(x1 - x0, y1 - y0) < _LEAST_REGION_PX:
            return None
        return _choose(self._detect_in(grey, (x0, y0, x1, y1), predicted), predicted.point_px)

    def response_of(self, image: ArrayLike) -> Response:
        """The response that an image is read with: the stated one, or that of its kind."""
        if self.response is not None:
            return self.response
        return default_response(colour=has_colours(image))

    def _grey(self, image: ArrayLike) -> NDArray[np.uint8]:
        """The levels of an image, and the light that they stand for kept for its fits."""
        self._light = light_of_levels(self.response_of(image))
        return measured_levels(image, self._size)

    def _check(self, predicted: Detection) -> None:
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

    def _flat(self, pixels: NDArray[np.float64]) -> FlatView | NoLens:
        """The plane about some pixels that the lens does not bend."""
        return _NO_LENS if self._lens is None else self._lens.flat_about(pixels)

    @abstractmethod
    def _detect_all(self, image: NDArray[np.uint8]) -> list[Detection]:
        """See `detect_all`, of an image in grey levels."""

    @abstractmethod
    def _detect_some(self, image: NDArray[np.uint8], way: int | None = None) -> list[Detection]:
        """As `_detect_all`, but what is found by the quick ways, or by one of them, is enough."""

    def _detect_rest(self, image: NDArray[np.uint8]) -> list[Detection]:
        """As `_detect_all`, in an image in which the quick ways find nothing."""
        return self._detect_all(image)

    @abstractmethod
    def _detect_in(
        self, image: NDArray[np.uint8], region: tuple[int, int, int, int], predicted: Detection
    ) -> list[Detection]:
        """Search a region x0 <= u < x1, y0 <= v < y1 for what was predicted."""

    @abstractmethod
    def _refined(self, image: NDArray[np.uint8], predicted: Detection) -> Detection | None:
        """Refine predicted corners; None where the target does not lie there."""


def as_pixel(name: str, value: ArrayLike) -> NDArray[np.float64]:
    """A place in an image.

    Args:
        name: what the message calls it.
        value: (2,) its u and v.

    Raises:
        ConfigurationError: this is none.
    """
    try:
        pixel = np.asarray(value, float)
    except (TypeError, ValueError):
        pixel = np.empty(0)
    if pixel.shape != (2,) or not np.isfinite(pixel).all():
        raise ConfigurationError(f"{name}: expected a pixel (u, v), got {value!r:.80}")
    return pixel


def _choose(found: Sequence[Detection], near_px: NDArray[np.float64] | None) -> Detection | None:
    """The nearest of several detections, or the largest."""
    if len(found) < 2:
        return found[0] if found else None
    if near_px is None:
        return max(found, key=lambda each: float(np.nanmean(np.ptp(each.corners_px, axis=0))))
    return min(found, key=lambda each: float(np.linalg.norm(each.point_px - near_px)))
