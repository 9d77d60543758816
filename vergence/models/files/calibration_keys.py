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
MODEL: Final = (
    "distortionmodel", "lensmodel", "cameramodel", "projectionmodel", "modeltype", "distortiontype",
    "lenstype", "lens", "model", "cameratype", "camtype", "type", "modelname", "cameramodelname",
    "lensname", "lensmodelname", "distortionmodelname",
)  # fmt: skip
FISHEYE: Final = ("fisheyemodel", "isfisheye", "usefisheye", "fisheye")
SIZE: Final = ("imagesize", "imgsize", "resolution", "imageresolution", "size")
SHAPE: Final = ("imageshape", "imgshape", "shape")
"""Rows by columns, as NumPy's `shape`."""
WIDTH: Final = ("imagewidth", "width", "imgwidth", "imagecols", "imgcols", "cols")
HEIGHT: Final = ("imageheight", "height", "imgheight", "imagerows", "imgrows", "rows")
BINNING: Final = (("binningx",), ("binningy",))
REGION: Final = (("roiwidth",), ("roiheight",), ("roixoffset",), ("roiyoffset",))
ROTATION: Final = (
    "r", "rotation", "rotationmatrix", "rmat", "rot", "stereor", "extrinsicr", "extrinsicsr",
)  # fmt: skip
TRANSLATION: Final = (
    "t", "translation", "translationvector", "tvec", "trans", "stereot", "extrinsict",
    "extrinsicst",
)  # fmt: skip
UNIT: Final = ("unit", "units", "lengthunit", "translationunit", "tunit", "squaresizeunit")
SQUARE: Final = ("squaresize", "square", "squarelength", "squarewidth", "sizeofsquare")
CHAINED: Final = ("tcncnm1",)
"""kalibr's T_cn_cnm1, the transform from the previous camera's frame to this one's."""
BODY_IN_CAMERA: Final = ("tcamimu", "tcambody", "tcb")
"""Transform from the frame of a body, such as an IMU, to the camera's (kalibr)."""
CAMERA_IN_BODY: Final = ("tbs", "timucam", "tbodycam", "bodyt", "tbc", "tic")
"""Transform from the camera's frame to that of a body (EuRoC, OpenVINS, VINS, ORB-SLAM3)."""
RECTIFICATION: Final = ("rectificationmatrix", "rectification", "r")
PROJECTION: Final = ("projectionmatrix", "projection", "p")

_NAMED_SIDES: Final = (("left", "right"), ("l", "r"))
"""Labels, other than numbers, by which keys distinguish the two cameras of a pair."""
_OTHER_MEANING: Final[dict[str, str]] = {
    "xi": "an omnidirectional lens (cv2.omnidir, MEI)",
    "alpha": "skew, or a lens of another model, such as EUCM (or stereoRectify's alpha: leave it "
    "out)",
    "alphac": "skew (calibrate with it fixed)",
    "skew": "skew (calibrate with it fixed)",
    **dict.fromkeys(
        ("rotate", "rotated", "rotateimage", "imagerotation"),
        "turned images (calibrate with those that the camera delivers)",
    ),
}  # fmt: skip
"""Values, by key, that change what the others mean, and that no camera here can have."""
_MIRRORED: Final = "mirrored images (calibrate with those that the camera delivers)"
_NO_MATTER: Final = re.compile(
    r"avg|mean|total|perview|reproj|rms|error|date|time|stamp|header|seq|frame|flag|fix|aspect"
    r"|point|board|pattern|corner|square|grid|marker|rostopic|overlap|name|serial|comment|version"
    r"|calibrationsigma|calibrationviews|rectif|projectionmatrix|roi|views|imagelist|imagepath|^images$"
    r"|sensortype|ratehz|rvec|tvec|criteria|extrinsicparameters|orbextractor|^viewer"
    r"|tcamimu|timucam|^(nr|num|n)?(of)?(images|pairs|shots)$|^(e|f|q|[rph][0-9]?)$"
    r"|(left|right|l|r|cam[0-9])[rp]$|^[rp](left|right|l|r)$|stereo(e|f|q)$"
)
"""Plain keys of a file that say nothing of cameras and their places, or follow from the others."""


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
    """Values of one or several calibration files, found under any known spelling of their keys."""

    def __init__(self, files: Mapping[str, Mapping[str, Any]]) -> None:
        self.name = ", ".join(files)
        self.used: dict[str, str] = {}  # name of the file by label of each value found
        self._found: dict[str, list[FoundValue]] = {}
        for name, content in files.items():
            for key, value in flatten_keys(_unwrapped(content)):
                plain = re.sub(r"[^a-z0-9]", "", key.lower())
                if re.search(r"k\d$", plain) and isinstance(value, int | float | str):
                    plain = f"coefficient{plain}"  # of a lens; K1 is a matrix
                self._found.setdefault(plain, []).append(FoundValue(value, f"{name}: {key}", name))

    def only(self, names: Collection[str]) -> "CalibrationValues":
        """The values of some of the files; what is found in them counts as found here."""
        part = CalibrationValues({})
        part.name, part.used = ", ".join(names), self.used
        for key, found in self._found.items():
            if kept := [one for one in found if one.file in names]:
                part._found[key] = kept
        return part

    def has(self, stems: Sequence[str], side: str = "") -> bool:
        """True if there is a value of any spelling."""
        return any(key in self._found for stem in stems for key in _keys(stem, side))

    def find(
        self, stems: Sequence[str], side: str = "", *, shared: bool = False
    ) -> FoundValue | None:
        """Find the value of the first spelling; None if absent. A `shared` one needs no side."""
        for stem in stems:
            for key in _keys(stem, side):
                found = self._found.get(key)
                if found:
                    for other in found[1:]:
                        if not _same(found[0].value, other.value):
                            raise ConfigurationError(
                                f"{other.label}: expected what {found[0].label} says, got "
                                f"something else"
                            )
                    self.used.update((one.label, one.file) for one in found)
                    return found[0]
        return self.find(stems) if shared and side else None

    def sides(self) -> tuple[str, str] | None:
        """Labels of the left and right camera in the keys; None unless there are two cameras."""
        for left, right in _NAMED_SIDES:
            if self.has(MATRIX, left) and self.has(MATRIX, right):
                return left, right
        numbers = [label for label in map(str, range(10)) if self.has(MATRIX, label)]
        if len(numbers) > 2:
            raise ConfigurationError(
                f"{self.name}: expected one or two cameras, got those of {', '.join(numbers)} (as "
                "in cam0): leave only the two that are the eyes in the file"
            )
        return (numbers[0], numbers[1]) if len(numbers) == 2 else None

    def refuse_other_meanings(self) -> None:
        """Refuse a value that changes the meaning of others and that is not supported."""
        for found in (one for same in self._found.values() for one in same):
            *_, key = found.label.removeprefix(f"{found.file}: ").split(".")
            spaced = re.sub(r"(?<=[a-z])(?=[A-Z0-9])", "_", key).lower()
            words = [word for word in re.split(r"[^a-z]+", spaced) if word not in _SIDE_WORDS]
            meaning = _OTHER_MEANING.get("".join(words))
            if any(re.match(r"mirror|[hv]?flip", word) for word in words):
                meaning = _MIRRORED
            numbers = parse_numbers(found.value)
            off = str(found.value).lower() in ("false", "no", "none", "off", "")
            if numbers is not None and "alpha" in words:
                off = off or bool((numbers == -1.0).all())  # stereoRectify's default
            if meaning and (off or (numbers is not None and not numbers.any())):
                self.used[found.label] = ""  # said, of no effect
            elif meaning:
                raise ConfigurationError(
                    f"{found.label}: expected a calibration of a pinhole or fisheye camera as "
                    f"OpenCV has them, got {found.value!r:.60}: {meaning}; this is not supported"
                )

    def unread(self) -> list[str]:
        """Labels of values that nothing has asked for, though they may be meant to count."""
        return [
            one.label
            for key, found in self._found.items()
            for one in found
            if one.label not in self.used and not _NO_MATTER.search(key)
        ]


_SIDE_WORDS: Final = {"", "left", "right", "l", "r", "cam", "camera"}
"""Words of a key that tell which camera it is of."""


def _keys(stem: str, side: str) -> Iterable[str]:
    return key_spellings(stem, side) if side else (stem,)


def refuse_unused_files(files: Iterable[str], values: CalibrationValues) -> None:
    """Refuse files that contribute nothing: the user may have meant them to count."""
    used = set(values.used.values())
    others = [name for name in files if name not in used]
    if others:
        raise ConfigurationError(
            f"{', '.join(others)}: expected files that belong together, got a calibration in "
            f"{', '.join(name for name in files if name in used)} that uses nothing else"
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
    """Finite numbers of a value, in one dimension and in one of the allowed counts."""
    values = parse_numbers(found.value)
    if values is not None and values.size in allowed_counts and np.isfinite(values).all():
        return values.reshape(-1)
    shown = found.value if values is None else values.tolist()
    got = f"{shown!r:.80}" if values is None or values.size < 10 else f"{values.size} numbers"
    if values is not None and values.size in allowed_counts:
        got = f"{got}, not all of them finite"
    raise ConfigurationError(f"{found.label}: expected {expected}, got {got}")
