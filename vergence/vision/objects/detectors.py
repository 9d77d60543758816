"""Detectors of objects in one image: those of the package, and a user's own."""

from collections.abc import Iterable
from inspect import signature
from typing import Any, Final

import numpy as np

from vergence.entry_points import accepted_arguments, user_error_with_place
from vergence.errors import ConfigurationError, VergenceError
from vergence.models.camera import Camera
from vergence.vision.detection import Detection, Detector
from vergence.vision.objects.colours import ColourDetector
from vergence.vision.objects.faces import FaceDetector
from vergence.vision.objects.targets import ColourTarget, FaceTarget, ObjectTarget, OwnTarget

_OPTIONAL: Final = (("id", None), ("score", 1.0), ("pose", None), ("size_px", None))
"""Fields of a detection that a user's own may lack, and their defaults."""
_OUTSIDE: Final = 0.5
"""How far outside of an image the centre of a thing that is cut off may lie, as a fraction of the
image's width (chosen: pixels of another size of image are refused)."""


class CheckedDetector:
    """A user's detector; an error in it names its file and line, and what it returns is checked."""

    def __init__(self, target: OwnTarget, camera: Camera) -> None:
        self._spec = target.entry.spec
        make = target.entry.load()
        if not callable(getattr(make, "detect", None)):
            raise ConfigurationError(
                f"target {self._spec}: expected a class with detect(image, hint), got {make!r:.60}"
            )
        accepted = accepted_arguments(make)
        given = {"camera": camera} if accepted is not None and "camera" in accepted else {}
        try:
            self.own: Any = make(**given)
        except (Exception, SystemExit) as error:
            raise self._blamed(error) from error
        form = signature(self.own.detect)
        try:
            form.bind(None, None)
        except TypeError as error:
            raise ConfigurationError(
                f"target {self._spec}: expected detect(image, hint), got detect{form}"
            ) from error

    def detect(self, image: Any, hint: Any) -> Any:
        """See `Detector.detect`.

        Raises:
            ConfigurationError: it raises, or returns something else than detections in the image.
        """
        try:
            found = self.own.detect(image, hint)
            if getattr(self.own, "both_eyes", False):
                lists = list(found) if isinstance(found, Iterable) else []
                if len(lists) != 2:
                    raise ConfigurationError(
                        f"target {self._spec}: expected detect to return two lists, of the left "
                        f"and the right image, as both_eyes is set, got {_one_line(found)}"
                    )
                return [self._checked(*each) for each in zip(lists, image, strict=True)]
            return self._checked(found, image)
        except VergenceError:
            raise
        except (Exception, SystemExit) as error:
            raise self._blamed(error) from error

    def _blamed(self, error: BaseException) -> ConfigurationError:
        return ConfigurationError(f"target {self._spec}: {user_error_with_place(error)}")

    def _checked(self, found: object, image: Any) -> list[Detection]:
        """The detections with arrays of floats."""
        if found is None:
            return []
        single = hasattr(found, "pixel") or not isinstance(found, Iterable)
        given: Any = [found] if single else found
        return [self._one(each, image) for each in given]

    def _one(self, given: Any, image: Any) -> Detection:
        rest: dict[str, Any] = {name: getattr(given, name, default) for name, default in _OPTIONAL}
        try:
            pixel = np.array(given.pixel, np.float64)
            sigma = np.array(getattr(given, "sigma_px", 1.0), np.float64)
            rest["score"] = float(rest["score"])
            rest["size_px"] = None if rest["size_px"] is None else float(rest["size_px"])
        except (AttributeError, TypeError, ValueError):
            pixel = sigma = np.empty(0)
        positive = sigma.shape in ((), (2,)) and bool((np.isfinite(sigma) & (sigma > 0.0)).all())
        if pixel.shape != (2,) or not np.isfinite(pixel).all() or not positive:
            raise ConfigurationError(
                f"target {self._spec}: expected detect to return a list of "
                "vergence.vision.Detection(pixel, sigma_px) with a finite pixel (u, v) and a "
                f"sigma above 0, got {_one_line(given)}"
            )
        height, width = image.shape[:2]
        half = np.array([width, height]) / 2
        if (np.abs(pixel - half) > half + _OUTSIDE * width).any():
            raise ConfigurationError(
                f"target {self._spec}: expected a pixel (u, v) in the image of {width} x {height} "
                f"pixels, or at most {_OUTSIDE * width:.0f} outside, got {_one_line(given)}"
            )
        return Detection(pixel, np.ones(2) * sigma, **rest)


def _one_line(value: object) -> str:
    return " ".join(repr(value).split())[:100]


def make_object_detector(target: ObjectTarget, camera: Camera) -> Detector:
    """Make the detector of an object in the images of one eye.

    Raises:
        ConfigurationError: the network or the class cannot be loaded.
    """
    if isinstance(target, ColourTarget):
        return ColourDetector(target, camera)
    if isinstance(target, FaceTarget):
        return FaceDetector(target, camera)
    if isinstance(target, OwnTarget):
        return CheckedDetector(target, camera)
    raise ConfigurationError(f"target {target}: expected one that a single image shows")
