"""Find all targets that are asked for in one eye's images."""

from collections.abc import Hashable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError
from vergence.models.camera import CameraResponse
from vergence.perception.light import LinearResponseCheck
from vergence.perception.unseen_rows import UnseenRowCheck
from vergence.vision import Camera, Detection, as_grey, make_detector, parse_target
from vergence.vision.image import read_pixels
from vergence.vision.targets import AprilTag, CharucoBoard, PlanarTarget, TagFamily, Target


class Photograph(NamedTuple):
    """An image and the targets found in it."""

    path: Path
    image: NDArray[np.uint8]
    """(height, width) grey levels."""
    detections: list[Detection]


def parse_targets(texts: Sequence[str]) -> list[Target]:
    """Parse targets from texts, see `vergence.vision.parse_target`."""
    if not texts:
        raise ConfigurationError(
            "target: expected at least one, such as --target tag:36h11:5:120 or "
            "--target checkerboard:9x6:24.23, got none"
        )
    return [parse_target(text) for text in dict.fromkeys(texts)]


def target_key(target: PlanarTarget) -> Hashable:
    """Key that is equal for detections of one target: family and number of a tag, else itself."""
    if isinstance(target, AprilTag):
        return target.family, target.id
    return target


def tag_number(target: PlanarTarget) -> int | None:
    """The number of a tag; None for a board."""
    return target.id if isinstance(target, AprilTag) else None


def is_of_target(detection: Detection, target: Target) -> bool:
    """True if a detection is of the target; tags are compared by family and number alone."""
    found = detection.target
    if isinstance(target, TagFamily):
        return isinstance(found, AprilTag) and found.family == target.family
    if isinstance(target, CharucoBoard) and isinstance(found, CharucoBoard):
        return replace(found, legacy=target.legacy) == target  # both layouts are searched for
    return target_key(found) == target_key(target)


_CLIPPED_GREY: Final = 254
"""Grey level from which on a pixel counts as clipped (chosen: just below 255, the largest)."""
_MAX_CLIPPED_FRACTION: Final = 0.15
"""Fraction of clipped pixels around a target above which its white is clipped (chosen: missed
against false remarks)."""


def is_white_clipped(image: NDArray[np.uint8], detection: Detection) -> bool:
    """True if the white of a target is clipped."""
    corners = detection.corners_px[np.isfinite(detection.corners_px).all(axis=1)]
    u0, v0 = np.maximum(corners.min(axis=0).astype(int), 0)
    u1, v1 = corners.max(axis=0).astype(int) + 1
    return bool((image[v0:v1, u0:u1] >= _CLIPPED_GREY).mean() > _MAX_CLIPPED_FRACTION)


class PhotographNotes:
    """Keeps track of targets and rows that no image has shown, and of images with clipped white."""

    def __init__(self, targets: Sequence[Target]) -> None:
        self._unseen = list(targets)
        self._asked = len(self._unseen)
        self._images = self._clipped = 0
        self._rows = UnseenRowCheck()

    def add(self, photograph: Photograph) -> None:
        """Add an image."""
        self._images += 1
        found = photograph.detections
        self._unseen = [t for t in self._unseen if not any(is_of_target(d, t) for d in found)]
        self._clipped += any(is_white_clipped(photograph.image, each) for each in found)
        for each in found:
            self._rows.add(each, photograph.image.shape)

    def notes(self) -> list[str]:
        """One line per target or last row in no image although others are, one on clipped white."""
        if len(self._unseen) == self._asked:
            return []  # callers report themselves that nothing was found
        images = f"{self._images} image{'' if self._images == 1 else 's'}"
        said = [f"{target}: found in 0 of {images}" for target in self._unseen]
        said += self._rows.notes()
        if self._clipped:
            said.append(
                f"white is clipped in {self._clipped} of {images}: its pixels count for nothing, "
                "and corners of tags are less sure; expose less"
            )
        return said


class TargetFinder:
    """Finds all targets in images of one eye, each tag for the first that it matches."""

    def __init__(
        self,
        targets: Sequence[Target],
        camera: Camera | None = None,
        response: CameraResponse | None = None,
    ) -> None:
        self.targets = targets
        self.camera = camera
        self.response_check = LinearResponseCheck()
        self._detectors = [make_detector(target, camera, response) for target in targets]

    def find(self, image: ArrayLike) -> list[Detection]:
        """Find all targets, in the order of `targets`, tags sorted by their numbers."""
        found: list[Detection] = []
        for detector in self._detectors:
            known = {target_key(one.target) for one in found}
            new = [d for d in detector.detect_all(image) if target_key(d.target) not in known]
            self.response_check.add(image, new, detector.response_of(image))
            found += sorted(new, key=lambda one: tag_number(one.target) or 0)
        return found

    def find_in_file(self, path: Path) -> Photograph:
        """Read an image and find all targets in it."""
        pixels = read_pixels(path)
        try:
            return Photograph(path, as_grey(pixels), self.find(pixels))
        except ConfigurationError as error:
            raise ConfigurationError(f"{path}: {error}") from error
