"""All targets that are looked for in one eye's images, and what is found of them."""

from collections.abc import Hashable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError
from vergence.models.boards import AprilTag, CharucoBoard, PlanarTarget, TagFamily, Target
from vergence.models.response import Response
from vergence.perception.light import ResponseCheck
from vergence.vision import Detection, EyeCamera, as_grey, make_detector, parse_target
from vergence.vision.image import read_pixels


class Photograph(NamedTuple):
    """An image and what is in it."""

    path: Path
    image: NDArray[np.uint8]
    """(height, width) grey levels."""
    found: list[Detection]


def parse_targets(texts: Sequence[str]) -> list[Target]:
    """The targets that texts name, see `vergence.vision.parse_target`.

    Raises:
        ConfigurationError: there is none, or a text cannot be.
    """
    if not texts:
        raise ConfigurationError(
            "target: expected at least one, such as --target tag:36h11:5:120 or "
            "--target checkerboard:9x6:24.23, got none"
        )
    return [parse_target(text) for text in dict.fromkeys(texts)]


def identity(target: PlanarTarget) -> Hashable:
    """What makes two detections ones of the same thing: of a tag family and number."""
    if isinstance(target, AprilTag):
        return target.family, target.id
    return target


def number_of(target: PlanarTarget) -> int | None:
    """The number of a tag; None for a board."""
    return target.id if isinstance(target, AprilTag) else None


def belongs(detection: Detection, target: Target) -> bool:
    """Whether a detection is of what was asked for: of a tag whichever text it was found by."""
    found = detection.target
    if isinstance(target, TagFamily):
        return isinstance(found, AprilTag) and found.family == target.family
    if isinstance(target, CharucoBoard) and isinstance(found, CharucoBoard):
        return replace(found, legacy=target.legacy) == target  # either layout is looked for
    return identity(found) == identity(target)


_CLIPPED_GREY: Final = 254
_MUCH_CLIPPED: Final = 0.15
"""Of the pixels around a target."""


def is_clipped(image: NDArray[np.uint8], detection: Detection) -> bool:
    """Whether the white of a target is as bright as a pixel can be.

    Args:
        image: (height, width) grey levels.
        detection: a target in it.
    """
    corners = detection.corners_px[np.isfinite(detection.corners_px).all(axis=1)]
    u0, v0 = np.maximum(corners.min(axis=0).astype(int), 0)
    u1, v1 = corners.max(axis=0).astype(int) + 1
    return bool((image[v0:v1, u0:u1] >= _CLIPPED_GREY).mean() > _MUCH_CLIPPED)


class Sought:
    """Which of the targets that were asked for have been found in any image, and how well lit.

    Args:
        targets: those that were asked for.
    """

    def __init__(self, targets: Sequence[Target]) -> None:
        self._unseen = list(targets)
        self._asked = len(self._unseen)
        self._images = self._clipped = 0

    def add(self, photograph: Photograph) -> None:
        """Take an image into account."""
        self._images += 1
        found = photograph.found
        self._unseen = [t for t in self._unseen if not any(belongs(d, t) for d in found)]
        self._clipped += any(is_clipped(photograph.image, each) for each in found)

    def notes(self) -> list[str]:
        """A line for each target that no image has, where others were found; and on the light."""
        if len(self._unseen) == self._asked:
            return []  # that nothing is found at all is said anyway
        images = f"{self._images} image{'' if self._images == 1 else 's'}"
        said = [f"{target}: found in 0 of {images}" for target in self._unseen]
        if self._clipped:
            said.append(
                f"white is clipped in {self._clipped} of {images}: its pixels count for nothing, "
                "and corners of tags are less sure; expose less"
            )
        return said


class Spotter:
    """Finds all targets in images of one eye.

    Args:
        targets: what to look for; a tag that several of them name belongs to the first.
        camera: the eye, whose lens and image size are taken into account; None if unknown.
        response: light by grey level; None for the camera's, see `make_detector`.
    """

    def __init__(
        self,
        targets: Sequence[Target],
        camera: EyeCamera | None = None,
        response: Response | None = None,
    ) -> None:
        self.targets = targets
        self.camera = camera
        self.check = ResponseCheck()
        self._detectors = [make_detector(target, camera, response) for target in targets]

    def spot(self, image: ArrayLike) -> list[Detection]:
        """Everything that is found, in the order of the targets, tags by their numbers.

        Args:
            image: any that `as_grey` takes.

        Raises:
            ConfigurationError: the image has another size than the camera's.
        """
        found: list[Detection] = []
        for detector in self._detectors:
            known = {identity(one.target) for one in found}
            new = [d for d in detector.detect_all(image) if identity(d.target) not in known]
            self.check.add(image, new, detector.response_of(image))
            found += sorted(new, key=lambda one: number_of(one.target) or 0)
        return found

    def spot_in(self, path: Path) -> Photograph:
        """Read an image and find everything in it.

        Args:
            path: the image's file.

        Returns:
            The image, and what is in it.

        Raises:
            ConfigurationError: the image has another size than the camera's.
            UnreadableFileError: it cannot be read.
        """
        pixels = read_pixels(path)
        try:
            return Photograph(path, as_grey(pixels), self.spot(pixels))
        except ConfigurationError as error:
            raise ConfigurationError(f"{path}: {error}") from error
