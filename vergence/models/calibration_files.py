"""Values of camera calibration files of many tools, by key."""

import json
import os
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from itertools import accumulate
from pathlib import Path
from typing import Any, Final, NamedTuple
from xml.etree import ElementTree

import numpy as np

from vergence.errors import ConfigurationError
from vergence.models.parts import FloatArray

_MAX_FILE_BYTES: Final = 50_000_000
"""Largest size of a calibration file; a file with every image point has a few million (chosen)."""
_LOOKED_AT: Final = 100_000
"""Characters of a file in which another program's format is looked for (chosen)."""
_MAX_DEPTH: Final = 100
"""Deepest nesting of values; the parsers would overflow the stack somewhere beyond (chosen)."""
READ_FORMATS: Final = (
    "calibrations are read as OpenCV (YAML, XML, JSON), ROS (camera_info), kalibr (camchain), "
    "EuRoC (sensor.yaml) and ORB-SLAM2 (LEFT.K, RIGHT.K) write them"
)
"""The calibration files that are read, for messages."""
_OTHER_TEXTS: Final[dict[str, str]] = {
    r"^\s*\[(LEFT|RIGHT)_CAM_": "ZED's settings",
    r"^# oST version|^\[image\]\s+width\s": "oST, of ROS's camera_calibration, which writes a YAML "
    "file (ost.yaml) beside it",
    r"^\s*\d+ +[A-Z_]+ +\d+ +\d+( +[-+\d.eE]+){3,}\s*$": "COLMAP's cameras.txt",
    r'"cameraData"\s*:|"batchName"\s*:': "OAK's (DepthAI) calibration",
    r'"value0"\s*:': "Basalt's calibration",
    r'"(ppx|rect\.0\.fx|coeffs)"\s*:': "RealSense's intrinsics",
    r"\b(mirror_parameters|projection_parameters)\s*:": "camodocal's (VINS) camera, without a "
    "camera matrix",
    r"^\s*Camera1?\.fx\s*:(?![\s\S]*^\s*LEFT\.K)": "ORB-SLAM's settings without LEFT.K",
    r"^\s*(fc|KK|cc)(_left|_right)?\s*=\s*\[": "the MATLAB toolbox's Calib_Results.m",
    r"<(calibration|sensor|Calibration)[ >]": "an XML file of another program (Agisoft's?)",
}
"""Calibration files of programs that are not read, by a pattern of their text."""
_TIGHT_KEY: Final = re.compile(r"^(\s*[\w.]+:)(?=[\[\d+-])", re.MULTILINE)
"""A key of OpenCV's YAML whose value follows without a space."""
_JSON_PART: Final = re.compile(r'"(?:[^"\\]|\\.)*"|[\[\]{}]', re.DOTALL)
"""A string of JSON, or a bracket."""
_NOT_FINITE: Final = re.compile(r"(?<![\w.])[+-]?(?:\.?nan|\.?inf)\b", re.IGNORECASE)


def read_calibration(path: str | os.PathLike[str]) -> Mapping[str, Any]:
    """Read YAML, XML or JSON into nested mappings, with arrays for OpenCV's matrices."""
    name = os.fspath(path)
    try:
        if os.path.getsize(name) > _MAX_FILE_BYTES:
            raise ConfigurationError(f"{name}: expected a calibration file, got one above 50 MB")
        text = Path(name).read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "not text in UTF-8"
        more = "" if isinstance(error, OSError) else f"; {READ_FORMATS}"
        raise ConfigurationError(f"{name}: {reason}; expected a calibration file{more}") from error
    if name.lower().endswith(".toml"):
        raise ConfigurationError(
            f"{name}: expected a calibration (YAML, XML or JSON), got a TOML file (a head file is "
            "none)"
        )
    for pattern, program in _OTHER_TEXTS.items():
        if re.search(pattern, text[:_LOOKED_AT], re.MULTILINE):
            raise ConfigurationError(
                f"{name}: expected a calibration file, got {program}, which is not read: "
                f"{READ_FORMATS}"
            )
    start = text.lstrip()[:1]
    kind = {"<": "XML", "{": "JSON"}.get(start, "YAML")
    try:
        parsed = _PARSERS[kind](text)
    except (ValueError, RecursionError, ElementTree.ParseError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ConfigurationError(
            f"{name}: expected a calibration file in {kind}, got: {reason:.200}; {READ_FORMATS}"
        ) from error
    if not isinstance(parsed, Mapping) or not parsed:
        raise ConfigurationError(
            f"{name}: expected keys with values, got {_kind_of(parsed)}; {READ_FORMATS}"
        )
    try:
        return {str(key): _with_matrices(value, f"{name}: {key}") for key, value in parsed.items()}
    except RecursionError as error:  # a file that contains itself by aliases
        raise ConfigurationError(f"{name}: expected a few nested keys, got endless ones") from error


def _kind_of(parsed: object) -> str:
    return "nothing" if not parsed else f"a {type(parsed).__name__}"


def _refuse_deep(steps: Iterable[int]) -> None:
    """Refuse values nested too deep; a step is 1 into a level and -1 out of it."""
    if any(depth > _MAX_DEPTH for depth in accumulate(steps)):
        raise ValueError(f"values nested more than {_MAX_DEPTH} deep")


def _parse_json(text: str) -> Any:
    parts = (match[0] for match in _JSON_PART.finditer(text))
    _refuse_deep((part in "[{") - (part in "]}") for part in parts)
    return json.loads(text)


def _yaml_steps(text: str, loader: Any) -> Iterator[int]:
    """Steps (1 or -1) into and out of the lists and mappings of a YAML text's first document."""
    import yaml

    for event in yaml.parse(text, loader):
        if isinstance(event, yaml.DocumentEndEvent):
            return
        yield isinstance(event, yaml.CollectionStartEvent) - isinstance(
            event, yaml.CollectionEndEvent
        )


def _parse_yaml(text: str) -> Any:
    import yaml

    class Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
        """Loader that drops unknown tags, such as `!!opencv-matrix`, and keeps their values."""

        def construct_mapping(self, node: Any, deep: bool = False) -> Any:
            """Refuse a key that stands twice, as where two files were joined."""
            for key, count in Counter(key.value for key, _ in node.value).items():
                if count > 1:
                    raise ValueError(f"the key {key!r:.80} twice")
            return super().construct_mapping(node, deep)

    def untagged(loader: Any, suffix: str, node: Any) -> Any:
        if isinstance(node, yaml.MappingNode):
            return loader.construct_mapping(node, deep=True)
        if isinstance(node, yaml.SequenceNode):
            return loader.construct_sequence(node, deep=True)
        return loader.construct_scalar(node)

    Loader.add_multi_constructor("", untagged)
    if text.startswith("%YAML"):  # OpenCV's `%YAML:1.0` and `data:[1, 2]` are not valid YAML
        text = _TIGHT_KEY.sub(r"\1 ", text.partition("\n")[2])
    try:
        _refuse_deep(_yaml_steps(text, Loader))
        # a recorded ROS topic has one document per message; the first is enough
        return next(iter(yaml.load_all(text, Loader)), None)
    except yaml.YAMLError as error:
        raise ValueError(str(error)) from error


def _parse_xml(text: str) -> Any:
    root = ElementTree.fromstring(text)
    if root.tag != "opencv_storage":
        raise ValueError(f"the root <{root.tag}>, where OpenCV writes <opencv_storage>")
    return {child.tag: _element(child) for child in root}


def _element(element: ElementTree.Element) -> Any:
    if len(element):
        if all(child.tag == "_" for child in element):
            return [_element(child) for child in element]
        return {child.tag: _element(child) for child in element}
    words = (element.text or "").split()
    values = [_number_or_text(word) for word in words]
    if not all(isinstance(value, float) for value in values):
        return (element.text or "").strip().strip('"')
    return values[0] if len(values) == 1 else values


def _number_or_text(word: str) -> float | str:
    try:
        return float(word)
    except ValueError:
        return word


_PARSERS: Final[dict[str, Callable[[str], Any]]] = {
    "XML": _parse_xml,
    "JSON": _parse_json,
    "YAML": _parse_yaml,
}


def _with_matrices(value: Any, where: str) -> Any:
    """Copy of a value with matrices that are written as mappings turned into arrays."""
    if isinstance(value, Mapping):
        if "data" in value and ("rows" in value or "sizes" in value):
            return _matrix(value, where)
        return {str(key): _with_matrices(v, f"{where}: {key}") for key, v in value.items()}
    return value


def _matrix(value: Mapping[str, Any], where: str) -> FloatArray:
    if "rows" in value:
        shape = [value["rows"], value.get("cols", 1)]
    else:
        sizes = value["sizes"]
        shape = list(sizes) if isinstance(sizes, Sequence) else [sizes]
    data = parse_numbers(value["data"])
    try:
        sides = [int(side) for side in shape]
        sides = sides if all(0 <= side <= 10**6 for side in sides) else []
    except (TypeError, ValueError, OverflowError):
        sides = []
    count = int(np.prod(sides)) if sides and min(sides) > 0 else 0
    # an element may hold several numbers, such as the two of an image point
    if data is None or (data.size % count or not data.size if count else data.size):
        got = f"{data.size} numbers" if data is not None else "no numbers"
        raise ConfigurationError(f"{where}: expected {sides or shape!r:.60} numbers, got {got}")
    return data.reshape([*sides, -1] if count and data.size > count else sides)


def parse_numbers(value: Any) -> FloatArray | None:
    """Convert a value to a float array, or None; strings too: YAML 1.1 reads `1e-5` as a string."""
    if isinstance(value, bool | Mapping) or value is None:
        return None
    if isinstance(value, list):  # OpenCV's .Nan and .Inf
        value = [
            float(one.replace(".", ""))
            if isinstance(one, str) and _NOT_FINITE.fullmatch(one)
            else one
            for one in value
        ]
    try:
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return None


def flatten_keys(value: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Values of nested mappings, each with its path of keys joined by dots."""
    for key, inner in value.items():
        if isinstance(inner, Mapping):
            yield from flatten_keys(inner, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", inner


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
