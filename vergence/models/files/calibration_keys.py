"""What calibration files call things: many spellings of one key, for one camera or for two."""

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from vergence.errors import ConfigurationError
from vergence.models.files.calibration_text import flattened, numbers
from vergence.models.parts import FloatArray

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
CHAIN: Final = ("cam1tcncnm1",)
"""kalibr's transform from the first camera's frame to the second's."""
RECTIFICATION: Final = ("rectificationmatrix", "rectification", "r")
PROJECTION: Final = ("projectionmatrix", "projection", "p")

SIDES: Final = (("1", "2"), ("left", "right"), ("l", "r"), ("0", "1"))
"""How the two cameras of a pair are told apart."""


class Found(NamedTuple):
    """A value of a file."""

    value: Any
    label: str
    """The file and the key, as messages call them."""
    file: str


def spellings(stem: str, side: str) -> Iterator[str]:
    """How a key of one camera of a pair may be written, such as `cameramatrix1` or `leftk`."""
    yield stem + side
    yield side + stem
    for camera in ("cam", "camera"):
        yield camera + side + stem
        yield side + camera + stem
        yield stem + camera + side
        yield camera + stem + side


class Keys:
    """The values of one or several files by key, however the key is written.

    Args:
        files: by name, as `read_calibration` gives them.

    Attributes:
        used: the files of the values that have been found.
    """

    def __init__(self, files: Mapping[str, Mapping[str, Any]]) -> None:
        self.name = ", ".join(files)
        self.used: set[str] = set()
        self._found: dict[str, list[Found]] = {}
        for name, content in files.items():
            for key, value in flattened(_unwrapped(content)):
                plain = re.sub(r"[^a-z0-9]", "", key.lower())
                self._found.setdefault(plain, []).append(Found(value, f"{name}: {key}", name))

    def find(self, stems: Sequence[str], side: str = "") -> Found | None:
        """The value of the first stem that is there.

        Args:
            stems: what the key may be called.
            side: whose camera of a pair; empty for a key without one.

        Raises:
            ConfigurationError: two files say different things about it.
        """
        for stem in stems:
            for key in spellings(stem, side) if side else (stem,):
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
        """How the two cameras are told apart; None where there are no two."""
        for left, right in SIDES:
            if self.find(MATRIX, left) and self.find(MATRIX, right):
                return left, right
        return None


def refuse_unused(files: Iterable[str], used: Collection[str]) -> None:
    """Refuse files of which nothing would be used: they may be what was meant.

    Args:
        files: all that were given.
        used: those of which something is used.

    Raises:
        ConfigurationError: names the others.
    """
    others = [name for name in files if name not in used]
    if others:
        raise ConfigurationError(
            f"{', '.join(others)}: expected files that belong together, got a calibration in "
            f"{', '.join(name for name in files if name in used)} that uses nothing else"
        )


def _unwrapped(content: Mapping[str, Any]) -> Mapping[str, Any]:
    """What stands below keys that hold everything."""
    while len(content) == 1:
        (inner,) = content.values()
        if not isinstance(inner, Mapping):
            break
        content = inner
    return content


def _same(one: Any, other: Any) -> bool:
    first, second = numbers(one), numbers(other)
    if first is None or second is None:
        return bool(first is second) and str(one) == str(other)
    return bool(np.array_equal(first, second))


def array_of(found: Found, sizes: Sequence[int], expected: str) -> FloatArray:
    """The numbers of a value, in one row.

    Args:
        found: the value.
        sizes: how many there may be.
        expected: what a message says should stand there.

    Raises:
        ConfigurationError: they are no finite numbers, or as many as they may not be.
    """
    values = numbers(found.value)
    if values is not None and values.size in sizes and np.isfinite(values).all():
        return values.reshape(-1)
    shown = found.value if values is None else values.tolist()
    got = f"{shown!r:.80}" if values is None or values.size < 10 else f"{values.size} numbers"
    if values is not None and values.size in sizes:
        got = f"{got}, not all of them finite"
    raise ConfigurationError(f"{found.label}: expected {expected}, got {got}")
