"""Detectors of objects in one image: a blob of a colour, faces, and a user's own."""

from collections.abc import Sequence
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.entry_points import accepted_arguments, user_error_with_place
from vergence.errors import ConfigurationError, VergenceError
from vergence.models.camera import SRGB, Camera, light_table
from vergence.models.parts import FloatArray
from vergence.vision.detection import Detection, Detector
from vergence.vision.objects.targets import ColourTarget, FaceTarget, ObjectTarget, OwnTarget

ColourImage = NDArray[np.uint8]
"""(height, width, 3) blue, green and red levels."""
_HUE_TOLERANCE_DEG: Final = 18.0
"""Greatest difference of hue, degrees (chosen: white balance and shading against other colours)."""
_LEAST_SATURATION: Final = 0.5
"""Least saturation, as a fraction of the target's (chosen: highlights against the background)."""
_LEAST_VALUE: Final = 40
"""Least value in HSV; the hue of darker pixels is noise (chosen)."""
_LEAST_AREA_PX: Final = 12
"""Least area of a blob, px^2 (chosen: above noise)."""
_MOST_BLOBS: Final = 8
"""Most candidates in an image, the largest first (chosen)."""
_BAND_PX: Final = 3
"""Width of the band round a blob in which pixels are covered in part, px (chosen: lens blur and
JPEG's halved chroma)."""
_SHARE_SIGMA: Final = 0.08
"""Standard deviation of a band pixel's share besides its noise (chosen: texture of the
background)."""
_FACE_SIGMA: Final = 0.03
"""Standard deviation of a face's position, as a fraction of its width (chosen: spread of YuNet's
landmarks over frames)."""
_FACE_SCORE: Final = 0.6
"""Least score of a face (chosen: OpenCV's example has 0.9 for photographs, webcams need less)."""


class ColourDetector:
    """Finds blobs of a colour; each pixel at an edge counts by the share of it that is covered.

    Shares are linear in light: a pixel's chroma along the target's, between that of the blob and
    that of what surrounds it. The position is the centroid of the shares; its variance follows from
    their noise, measured within the blob.
    """

    def __init__(self, target: ColourTarget, camera: Camera) -> None:
        response = SRGB if camera.response is None else camera.response
        self._light = (light_table(response) / 255.0).astype(np.float32)
        rgb = np.array(target.rgb, np.uint8)
        hue, saturation, _value = cv2.cvtColor(rgb[None, None, ::-1], cv2.COLOR_BGR2HSV)[0, 0]
        self._hue, self._saturation = float(hue), _LEAST_SATURATION * float(saturation)
        light = light_table(SRGB)[rgb[::-1]]
        self._axis = (light - light.mean()).astype(np.float32)
        self._axis /= np.linalg.norm(self._axis)

    def detect(self, image: ColourImage, hint: FloatArray | None = None) -> list[Detection]:
        """See `Detector.detect`; the score is the blob's share of the image."""
        hsv = cv2.cvtColor(image, cv2.COLOR_BGR2HSV)
        turned = (hsv[..., 0].astype(np.int16) - round(self._hue) + 90) % 180 - 90  # in 2 degrees
        mask = (np.abs(turned) <= 0.5 * _HUE_TOLERANCE_DEG) & (hsv[..., 1] >= self._saturation)
        mask &= hsv[..., 2] >= _LEAST_VALUE
        solid = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
        _count, labels, stats, _centres = cv2.connectedComponentsWithStats(solid)
        areas = stats[1:, cv2.CC_STAT_AREA]
        order = [i + 1 for i in np.argsort(-areas, kind="stable") if areas[i] >= _LEAST_AREA_PX]
        return [self._measure(image, labels, label, stats[label]) for label in order[:_MOST_BLOBS]]

    def _measure(self, image: ColourImage, labels: Any, label: int, stats: Any) -> Detection:
        x, y, width, height, area = (int(value) for value in stats)
        reach = 2 * _BAND_PX
        rows = slice(max(y - reach, 0), min(y + height + reach, image.shape[0]))
        columns = slice(max(x - reach, 0), min(x + width + reach, image.shape[1]))
        chroma = self._light[image[rows, columns]] @ self._axis
        blob: Any = (labels[rows, columns] == label).astype(np.uint8)
        kernel = np.ones((3, 3), np.uint8)
        inside: Any = cv2.erode(blob, kernel, iterations=1)
        inside = inside if inside.any() else blob
        core: Any = cv2.erode(blob, kernel, iterations=2)
        core = core if core.any() else inside
        near: Any = cv2.dilate(blob, kernel, iterations=_BAND_PX)
        outside: Any = cv2.dilate(near, kernel, iterations=_BAND_PX) & ~near & 1
        within, beyond = _local_mean(chroma, core), _local_mean(chroma, outside)
        step = np.maximum(within - beyond, 1e-6)
        share = np.where(near, np.clip((chroma - beyond) / step, 0.0, 1.0), 0.0)
        share[inside > 0] = 1.0
        total = float(share.sum())
        v, u = np.mgrid[rows, columns].astype(float)
        centre = np.array([(share * u).sum(), (share * v).sum()]) / total
        noise = _noise(chroma, core)
        band = (near > 0) & (inside == 0)
        variance = np.where(band, (noise / step) ** 2 + _SHARE_SIGMA**2, 0.0)
        sigma = [
            float(np.sqrt((variance * (a - c) ** 2).sum())) / total
            for a, c in zip((u, v), centre, strict=True)
        ]
        size_px = float(np.sqrt(4.0 * total / np.pi))
        at_edge = x == 0 or y == 0 or x + width == image.shape[1] or y + height == image.shape[0]
        sigma = [max(value, 0.25 * size_px if at_edge else 0.0) for value in sigma]  # cut off there
        score = float(np.sqrt(area / labels.size))
        return Detection(centre, np.array(sigma), None, score, size_px=size_px)


def _local_mean(values: Any, mask: Any) -> Any:
    """Mean of the values under a mask near each pixel; that of all of them where none is near."""
    if not mask.any():
        return np.zeros_like(values)
    size = (4 * _BAND_PX + 1, 4 * _BAND_PX + 1)
    count = cv2.blur(mask.astype(np.float32), size)
    mean = cv2.blur(values * mask, size) / np.maximum(count, 1e-6)
    return np.where(count > 1e-6, mean, float(values[mask > 0].mean()))


def _noise(values: Any, mask: Any) -> float:
    """Standard deviation of pixels from the mean of their neighbours, under a mask."""
    off = (values - cv2.blur(values, (3, 3)))[mask > 0]
    return float(np.sqrt(9.0 / 8.0) * 1.4826 * np.median(np.abs(off)))


class FaceDetector:
    """Finds faces by a network in the form of YuNet; the position is the mean of its landmarks."""

    def __init__(self, target: FaceTarget, camera: Camera) -> None:
        try:
            self._network = cv2.FaceDetectorYN.create(target.model, "", camera.size, _FACE_SCORE)
        except cv2.error as error:
            raise ConfigurationError(
                f"target {target}: expected a network in the form of YuNet, such as OpenCV's "
                f"face_detection_yunet_2023mar.onnx: {' '.join(str(error).split())[-120:]}"
            ) from error

    def detect(self, image: ColourImage, hint: FloatArray | None = None) -> list[Detection]:
        """See `Detector.detect`."""
        faces: Any = self._network.detect(image)[1]
        found = []
        rows: Any = [] if faces is None else np.asarray(faces, float)
        for row in np.asarray(rows, float):
            width = float(row[2])
            sigma = np.full(2, _FACE_SIGMA * width)
            centre = row[4:14].reshape(5, 2).mean(axis=0)
            found.append(Detection(centre, sigma, None, float(row[14]), size_px=width))
        return found


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
        except Exception as error:
            raise self._blamed(error) from error

    def detect(self, image: Any, hint: Any) -> Any:
        """See `Detector.detect`.

        Raises:
            ConfigurationError: it raises, or returns something else than detections.
        """
        try:
            found = self.own.detect(image, hint)
            if getattr(self.own, "both_eyes", False):
                left, right = found
                return [self._checked(left), self._checked(right)]
            return self._checked(found)
        except VergenceError:
            raise
        except Exception as error:
            raise self._blamed(error) from error

    def _blamed(self, error: Exception) -> ConfigurationError:
        return ConfigurationError(f"target {self._spec}: {user_error_with_place(error)}")

    def _checked(self, found: object) -> list[Detection]:
        """The detections with arrays of floats."""
        out = []
        given: Any = found if isinstance(found, Sequence) else [found]
        for one in given:
            try:
                pixel = np.asarray(one.pixel, np.float64)
                sigma = np.ones(2) * np.asarray(one.sigma_px, np.float64)
            except (AttributeError, TypeError, ValueError):
                pixel, sigma = np.empty(0), np.ones(2)
            if pixel.shape != (2,) or not np.isfinite(pixel).all() or not (sigma > 0.0).all():
                raise ConfigurationError(
                    f"target {self._spec}: expected detect to return a list of "
                    "vergence.vision.Detection(pixel, sigma_px) with a finite pixel (u, v) and a "
                    f"sigma above 0, got {one!r:.100}"
                )
            rest: Any = (getattr(one, name, default) for name, default in _OPTIONAL)
            out.append(Detection(pixel, sigma, *rest))
        return out


_OPTIONAL: Final = (("id", None), ("score", 1.0), ("pose", None), ("size_px", None))
"""Fields of a detection that a user's own may lack, and their defaults."""


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
