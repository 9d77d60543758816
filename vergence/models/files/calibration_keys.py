"""Lookup of calibration values by key, for the many spellings that files use, one camera or two."""

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from vergence.errors import ConfigurationError
from vergence.models.files.calibration_text import flatten_keys, parse_numbers
from vergence.models.parts import FloatArray

# Known spellings of each key, lower-case without punctuation, in order of lookup.
MATRIX: Final = (
    "cameramatrix", "k", "m", "intrinsics", "intrinsic", "intrinsicmatrix", "intrinsicsmatrix",
    "cammatrix", "cammat", "cameramat", "matrix", "mtx",
)  # fmt: skip
DISTORTION: Final = (
    "distortioncoefficients", "distcoeffs", "d", "distortioncoeffs", "distortioncoefs",
    "distortioncoeff", "distortionvector", "distortion", "distcoeff", "distcoefs", "distcoef",
    "distortions", "dist", "kc",
)  # fmt: skip
MODEL: Final = ("distortionmodel", "lensmodel", "lens")
CAMERA_MODEL: Final = ("cameramodel", "projectionmodel")
FISHEYE: Final = ("fisheyemodel", "isfisheye", "usefisheye", "fisheye")
SIZE: Final = ("imagesize", "imgsize", "resolution", "imageresolution", "size")
WIDTH: Final = ("imagewidth", "width", "imgwidth")
HEIGHT: Final = ("imageheight", "height", "imgheight")
BINNING: Final = (("binningx",), ("binningy",))
REGION: Final = (("roiwidth",), ("roiheight",), ("roixoffset",), ("roiyoffset",))
ROTATION: Final = (
    "r", "rotation", "rotationmatrix", "rmat", "rot", "stereor", "extrinsicr", "extrinsicsr",
)  # fmt: skip
TRANSLATION: Final = (
    "t", "translation", "translationvector", "tvec", "trans", "stereot", "extrinsict",
    "extrinsicst",
)  # fmt: skip
KALIBR_TRANSFORM: Final = ("cam1tcncnm1",)
"""kalibr's T_cn_cnm1, the transform from the first camera's frame to the second's."""
RECTIFICATION: Final = ("rectificationmatrix", "rectification", "r")
PROJECTION: Final = ("projectionmatrix", "projection", "p")

SIDES: Final = (("1", "2"), ("left", "right"), ("l", "r"), ("0", "1"))
"""Labels by which keys distinguish the two cameras of a pair."""


class FoundValue(NamedTuple):
    """A value found in a calibration file."""

    value: Any
    label: str
    """Name of the file and the key, for messages."""
    file: str
    """Name of the file."""


def key_spellings(stem: str, side: str) -> Iterator[str]:
    """Possible spellings of a key of one camera of a pair, such as `cameramatrix1` or `leftk`."""
    yield stem + side
    yield side + stem
    for camera in ("cam", "camera"):
        yield camera + side + stem
        yield side + camera + stem
        yield stem + camera + side
        yield camera + stem + side


class CalibrationValues:
    """Values of one or several calibration files, found under any known spelling of their keys.

    Args:
        files: content of each file by name, from `read_calibration`.

    Attributes:
        used: names of the files in which a value has been found.
    """

    def __init__(self, files: Mapping[str, Mapping[str, Any]]) -> None:
        self.name = ", ".join(files)
        self.used: set[str] = set()
        self._found: dict[str, list[FoundValue]] = {}
        for name, content in files.items():
            for key, value in flatten_keys(_unwrapped(content)):
                plain = re.sub(r"[^a-z0-9]", "", key.lower())
                self._found.setdefault(plain, []).append(FoundValue(value, f"{name}: {key}", name))

    def find(self, stems: Sequence[str], side: str = "") -> FoundValue | None:
        """Find the value of the first spelling that is present; None if there is none.

        Args:
            stems: possible spellings of the key, without a side.
            side: label of one camera of a pair, see `SIDES`; empty for a key without one.

        Raises:
            ConfigurationError: the key occurs several times with different values.
        """
        for stem in stems:
            for key in key_spellings(stem, side) if side else (stem,):
                found = self._found.get(key)
                if found:
                    for other in found[1:]:
                        if not _same(found[0].value, other.value):
                            raise ConfigurationError(
                                f"{other.label}: expected what {found[0].label} says, got "
                                f"something else"
                            )
                    self.used.update(one.file for one in found)
                    return found[0]
        return None

    def sides(self) -> tuple[str, str] | None:
        """Labels of the left and right camera in the keys; None unless there are two cameras."""
        for left, right in SIDES:
            if self.find(MATRIX, left) and self.find(MATRIX, right):
                return left, right
        return None


def refuse_unused_files(files: Iterable[str], used_files: Collection[str]) -> None:
    """Refuse files that contribute nothing: the user may have meant them to count.

    Args:
        files: names of all files given.
        used_files: names of the files that contribute a value.

    Raises:
        ConfigurationError: some files are unused; the message names them.
    """
    others = [name for name in files if name not in used_files]
    if others:
        raise ConfigurationError(
            f"{', '.join(others)}: expected files that belong together, got a calibration in "
            f"{', '.join(name for name in files if name in used_files)} that uses nothing else"
        )


def _unwrapped(content: Mapping[str, Any]) -> Mapping[str, Any]:
    """Content below outer keys that are alone on their level."""
    while len(content) == 1:
        (inner,) = content.values()
        if not isinstance(inner, Mapping):
            break
        content = inner
    return content


def _same(one: Any, other: Any) -> bool:
    first, second = parse_numbers(one), parse_numbers(other)
    if first is None or second is None:
        return bool(first is second) and str(one) == str(other)
    return bool(np.array_equal(first, second))


def flat_array_of(found: FoundValue, allowed_counts: Sequence[int], expected: str) -> FloatArray:
    """Numbers of a value, flattened to one dimension.

    Args:
        found: the value.
        allowed_counts: allowed counts of numbers.
        expected: description of the expected value, for messages.

    Raises:
        ConfigurationError: the value is not numeric or not finite, or has another count.
    """
    values = parse_numbers(found.value)
    if values is not None and values.size in allowed_counts and np.isfinite(values).all():
        return values.reshape(-1)
    shown = found.value if values is None else values.tolist()
    got = f"{shown!r:.80}" if values is None or values.size < 10 else f"{values.size} numbers"
    if values is not None and values.size in allowed_counts:
        got = f"{got}, not all of them finite"
    raise ConfigurationError(f"{found.label}: expected {expected}, got {got}")
