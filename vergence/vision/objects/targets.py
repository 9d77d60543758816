"""Targets: printed ones, a colour, a face, an image point, and detectors of one's own."""

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from vergence.entry_points import EntryPoint, is_entry_point
from vergence.errors import ConfigurationError
from vergence.models.parts import EYE_NAMES
from vergence.vision.detection import as_pixel
from vergence.vision.targets import PRINTED_KINDS, Target, parse_target

_LEAST_CHROMA: Final = 40
"""Least difference between the greatest and the least level of a target's colour, 0 to 255 (chosen:
greys have no hue)."""


@dataclass(frozen=True, kw_only=True)
class ColourTarget:
    """The best blob of a hue and saturation, measured where the centre of a ball would be.

    Raises:
        ConfigurationError: the colour is nearly grey.
    """

    rgb: tuple[int, int, int]
    """Red, green and blue, sRGB levels from 0 to 255."""

    def __post_init__(self) -> None:
        if max(self.rgb) - min(self.rgb) < _LEAST_CHROMA:
            raise ConfigurationError(
                f"target {self}: expected a colour with a hue, such as colour:#ff8000, got one "
                "that is nearly grey"
            )

    def __str__(self) -> str:
        return f"colour:#{bytes(self.rgb).hex()}"


@dataclass(frozen=True, kw_only=True)
class FaceTarget:
    """A face, found by a network in the form of YuNet, `cv2.FaceDetectorYN`, or of BlazeFace."""

    model: str
    """The network's file, such as face_detection_yunet_2023mar.onnx or
    face_detection_short_range.tflite."""

    def __str__(self) -> str:
        return f"face:{self.model}"


@dataclass(frozen=True, kw_only=True)
class PointTarget:
    """A point of the scene, given by its pixel in one eye's first image, or by a click later."""

    eye: int | None = None
    """Eye of the pixel, 0 for left; None to wait for a click."""
    pixel: tuple[float, float] | None = None
    """Pixel (u, v)."""

    def __str__(self) -> str:
        if self.eye is None or self.pixel is None:
            return "point"
        return f"point:{EYE_NAMES[self.eye]}:{self.pixel[0]:g}:{self.pixel[1]:g}"


@dataclass(frozen=True, kw_only=True)
class PlaceTarget:
    """A place in space, looked at by the head's model alone: images only give the time."""

    point_mm: tuple[float, float, float]
    """Its position in N with the neck at rest, mm."""

    def __str__(self) -> str:
        return "place:" + ":".join(f"{value:g}" for value in self.point_mm)


@dataclass(frozen=True, kw_only=True)
class OwnTarget:
    """What a detector of one's own finds, see `vergence.vision.Detector`."""

    entry: EntryPoint

    def __str__(self) -> str:
        return self.entry.spec


ObjectTarget = ColourTarget | FaceTarget | PointTarget | PlaceTarget | OwnTarget
GazeTarget = Target | ObjectTarget
"""Anything that a head can look at."""
OBJECT_FORMS: Final = (
    "colour:#RRGGBB, face:MODEL.onnx, point (with --pixel EYE U V), place:X:Y:Z or mine.py:Class"
)
"""Texts of targets that are not printed, for messages."""


def parse_gaze_target(text: str, pixel: tuple[str, float, float] | None = None) -> GazeTarget:
    """Parse the text form of anything that a head can look at.

    Args:
        text: a printed target, see `parse_target`; ``colour:#RRGGBB``; ``face:MODEL.onnx`` or
            ``face:MODEL.tflite``; ``point`` or ``point:EYE:U:V``; ``place:X:Y:Z``, mm;
            ``module:Class`` or ``mine.py:Class``.
        pixel: the eye, ``left`` or ``right``, and the pixel (u, v) of a ``point``.

    Returns:
        The target.

    Raises:
        ConfigurationError: the text has none of these forms, or a value is invalid.
    """
    text = str(text).strip()
    kind, _, rest = text.partition(":")
    kind = kind.strip().lower()
    if pixel is not None and kind != "point":
        raise ConfigurationError(f"pixel: expected --target point beside it, got {text!r:.100}")
    if kind in ("colour", "color"):
        rgb = parse_rgb(rest)
        if rgb is None:
            raise ConfigurationError(
                f"colour: expected #RRGGBB, such as #ff8000, got {text!r:.100}"
            )
        return ColourTarget(rgb=rgb)
    if kind == "face":
        if not Path(rest.strip()).is_file():
            raise ConfigurationError(
                "target: expected face:MODEL.onnx with a file that exists, such as OpenCV's "
                f"face_detection_yunet_2023mar.onnx, got {text!r:.200}"
            )
        return FaceTarget(model=rest.strip())
    if kind == "point":
        return _point(text, list(pixel) if pixel else rest.split(":") if rest else [])
    if kind == "place":
        return PlaceTarget(point_mm=_place(text, rest.split(":")))
    if kind in PRINTED_KINDS:
        return parse_target(text)
    if is_entry_point(text) and text.rpartition(":")[2].isidentifier():
        return OwnTarget(entry=EntryPoint.of(text, "target"))
    raise ConfigurationError(
        "target: expected tag:36h11:5:120, checkerboard:9x6:24 or another printed target "
        f"(lengths in mm), {OBJECT_FORMS}; got {text!r:.100}"
    )


def parse_rgb(text: str) -> tuple[int, int, int] | None:
    """Levels of a colour, #RRGGBB; None if it is none."""
    found = re.fullmatch(r"\s*#?([0-9a-fA-F]{6})\s*", text)
    if found is None:
        return None
    red, green, blue = bytes.fromhex(found[1])
    return red, green, blue


def _point(text: str, parts: list[Any]) -> PointTarget:
    if not parts:
        return PointTarget()
    try:
        name, u, v = parts
        u, v = as_pixel("pixel", (u, v)).tolist()
        return PointTarget(eye=EYE_NAMES.index(str(name).strip().lower()), pixel=(u, v))
    except (ValueError, ConfigurationError):
        raise ConfigurationError(
            "target: expected point, or point:EYE:U:V with an eye, left or right, and a pixel, got "
            f"{text if len(parts) < 3 else ' '.join(map(str, parts))!r:.100}"
        ) from None


def _place(text: str, parts: list[str]) -> tuple[float, float, float]:
    try:
        x, y, z = (float(part) for part in parts)
    except ValueError:
        x = y = z = math.nan
    if not all(map(math.isfinite, (x, y, z))):
        raise ConfigurationError(
            f"target: expected place:X:Y:Z with three numbers, mm, got {text!r:.100}"
        )
    return x, y, z
