"""Values of camera calibration files of many tools, by key."""

import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from math import prod
from pathlib import Path
from typing import Any, ClassVar, Final, NamedTuple
from xml.etree import ElementTree

import numpy as np
import yaml

from vergence.errors import ConfigurationError
from vergence.models.parts import FloatArray

_MAX_CHARACTERS: Final = 50_000_000  # a file with every image point has a few million (chosen)
_LOOKED_AT: Final = 100_000  # characters, for the format of another program (chosen)
_MAX_DEPTH: Final = 100  # of YAML; its parser would overflow the stack somewhere beyond (chosen)
_MAX_UNREAD: Final = 6  # most keys that are named as not read (chosen)
READ_FORMATS: Final = (
    "calibrations are read as OpenCV (YAML, XML, JSON), ROS (camera_info), kalibr (camchain), "
    "EuRoC (sensor.yaml) and ORB-SLAM2 (LEFT.K, RIGHT.K) write them"
)
_OTHER_TEXTS: Final = {
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
# A key of OpenCV's YAML whose value follows without a space.
_TIGHT_KEY: Final = re.compile(r"^(\s*[\w.]+:)(?=[\[\d+-])", re.MULTILINE)
_NOT_FINITE: Final = re.compile(r"([+-]?)\.?(nan|inf)", re.IGNORECASE)


def unexpected(label: str, expected: str, got: object) -> ConfigurationError:
    """Error about the value of a file or a key."""
    return ConfigurationError(f"{label}: expected {expected}, got {got}")


def _read_file(name: str) -> list[tuple[str, Any]]:
    """Values of a YAML, XML or JSON file by dotted key, with arrays for OpenCV's matrices."""
    try:
        with Path(name).open(encoding="utf-8-sig") as file:
            text = file.read(_MAX_CHARACTERS + 1)
    except OSError as error:
        raise ConfigurationError(
            f"{name}: {error.strerror}; expected a calibration file"
        ) from error
    except ValueError as error:
        raise ConfigurationError(
            f"{name}: not text in UTF-8; expected a calibration file; {READ_FORMATS}"
        ) from error
    if len(text) > _MAX_CHARACTERS:
        raise unexpected(name, "a calibration file", "one of more than 50 million characters")
    if name.lower().endswith(".toml"):
        raise unexpected(
            name, "a calibration (YAML, XML or JSON)", "a TOML file (a head file is none)"
        )
    for pattern, program in _OTHER_TEXTS.items():
        if re.search(pattern, text[:_LOOKED_AT], re.MULTILINE):
            got = f"{program}, which is not read: {READ_FORMATS}"
            raise unexpected(name, "a calibration file", got)
    kind = {"<": "XML", "{": "JSON"}.get(text.lstrip()[:1], "YAML")
    parse = {"XML": _parse_xml, "JSON": _parse_json, "YAML": _parse_yaml}[kind]
    try:
        parsed = parse(text)
    except (ValueError, RecursionError, ElementTree.ParseError, yaml.YAMLError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        if isinstance(error, RecursionError):
            reason = f"values nested more than {_MAX_DEPTH} deep"
        raise ConfigurationError(
            f"{name}: expected a calibration file in {kind}, got: {reason:.200}; {READ_FORMATS}"
        ) from error
    if not isinstance(parsed, Mapping) or not parsed:
        got = f"a {type(parsed).__name__}" if parsed else "nothing"
        raise unexpected(name, "keys with values", f"{got}; {READ_FORMATS}")
    try:
        return list(_flattened(parsed, name))
    except RecursionError as error:  # a file that contains itself by aliases
        raise unexpected(name, "a few nested keys", "endless ones") from error


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """Loader that drops unknown tags, such as `!!opencv-matrix`, and keeps their values."""

    # no entry for None, which would refuse them
    yaml_constructors: ClassVar = {
        tag: one for tag, one in yaml.SafeLoader.yaml_constructors.items() if tag
    }

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        """Refuse a key that stands twice."""
        _unique((str(key.value), None) for key, _ in node.value)
        return super().construct_mapping(node, deep)


def _unique(pairs: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """Values by key; a key that stands twice, as where two files were joined, is refused."""
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise ValueError(f"the key {key!r:.80} twice")
        found[key] = value
    return found


def _parse_json(text: str) -> Any:
    return json.loads(text, object_pairs_hook=_unique)


def _parse_yaml(text: str) -> Any:
    if text.startswith("%YAML"):  # OpenCV's `%YAML:1.0` and `data:[1, 2]` are not valid YAML
        text = _TIGHT_KEY.sub(r"\1 ", text.partition("\n")[2])
    depth = 0
    for event in yaml.parse(text, _Loader):
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > _MAX_DEPTH:
            raise RecursionError
        if isinstance(event, yaml.DocumentEndEvent):
            break
    # a recorded ROS topic has one document per message; the first is enough
    return next(iter(yaml.load_all(text, _Loader)), None)


def _parse_xml(text: str) -> Any:
    root = ElementTree.fromstring(text)
    if root.tag != "opencv_storage":
        raise ValueError(f"the root <{root.tag}>, where OpenCV writes <opencv_storage>")
    return _unique((child.tag, _element(child)) for child in root)


def _element(element: ElementTree.Element) -> Any:
    if inner := [(child.tag, _element(child)) for child in element]:
        listed = all(tag == "_" for tag, _ in inner)
        return [value for _, value in inner] if listed else _unique(inner)
    text = element.text or ""
    try:
        values = [float(_NOT_FINITE.sub(r"\1\2", word)) for word in text.split()]
    except ValueError:
        return text.strip().strip('"')
    return values[0] if len(values) == 1 else values


def _flattened(
    content: Mapping[str, Any], where: str, prefix: str = "", outer: bool = True
) -> Iterator[tuple[str, Any]]:
    """Values of nested mappings by dotted key, without outer keys alone on their level."""
    outer = outer and len(content) == 1
    for key, value in content.items():
        inner = f"{where}: {key}"
        if not isinstance(value, Mapping):
            yield f"{prefix}{key}", value
        elif "data" in value and ("rows" in value or "sizes" in value):
            yield f"{prefix}{key}", _matrix(value, inner)
        else:
            yield from _flattened(value, inner, "" if outer else f"{prefix}{key}.", outer)


def _matrix(value: Mapping[str, Any], where: str) -> FloatArray:
    """Array of a matrix that is written as a mapping."""
    sizes = [value["rows"], value.get("cols", 1)] if "rows" in value else value["sizes"]
    shape = list(sizes) if isinstance(sizes, Sequence) else [sizes]
    numbers, data = parse_numbers(shape), parse_numbers(value["data"])
    if numbers is None or numbers.ndim != 1 or not ((numbers >= 0) & (numbers <= 1e6)).all():
        numbers = np.empty(0)
    sides = [int(side) for side in numbers]
    count = prod(sides)
    # an element may hold several numbers, such as the two of an image point
    if data is None or not sides or (data.size % count or not data.size if count else data.size):
        got = "no" if data is None else str(data.size)
        raise unexpected(where, f"{sides or shape!r:.60} numbers", f"{got} numbers")
    return data.reshape([*sides, -1] if data.size > count else sides)


def parse_numbers(value: Any) -> FloatArray | None:
    """Convert a value to a float array, or None; strings too: YAML 1.1 reads `1e-5` as a string."""
    if isinstance(value, bool | Mapping) or value is None:
        return None
    if isinstance(value, list):  # OpenCV's .Nan and .Inf
        value = [_NOT_FINITE.sub(r"\1\2", x) if isinstance(x, str) else x for x in value]
    try:
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return None


# Known spellings of each key, lower-case without punctuation, in order of lookup.
SPELLINGS: Final = {
    name: spellings.split()
    for name, spellings in {
        "MATRIX": "cameramatrix k m intrinsics intrinsic intrinsicmatrix intrinsicsmatrix "
        "cammatrix cammat cameramat matrix mtx",
        "DISTORTION": "distortioncoefficients distcoeffs d distortioncoeffs distortioncoefs "
        "distortioncoeff distortionvector distortion distcoeff distcoefs distcoef distortions "
        "dist kc",
        "MODEL": "distortionmodel lensmodel cameramodel projectionmodel modeltype distortiontype "
        "lenstype lens model cameratype camtype type modelname cameramodelname lensname "
        "lensmodelname distortionmodelname",
        "FISHEYE": "fisheyemodel isfisheye usefisheye fisheye",
        "SIZE": "imagesize imgsize resolution imageresolution size",
        "SHAPE": "imageshape imgshape shape",  # rows by columns, as NumPy's
        "WIDTH": "imagewidth width imgwidth imagecols imgcols cols",
        "HEIGHT": "imageheight height imgheight imagerows imgrows rows",
        "ROTATION": "r rotation rotationmatrix rmat rot stereor extrinsicr extrinsicsr",
        "TRANSLATION": "t translation translationvector tvec trans stereot extrinsict extrinsicst",
        "UNIT": "unit units lengthunit translationunit tunit squaresizeunit",
        "SQUARE": "squaresize square squarelength squarewidth sizeofsquare",
        "CHAINED": "tcncnm1",  # kalibr's T_cn_cnm1, from the previous camera's frame to this one's
        "BODY_IN_CAMERA": "tcamimu tcambody tcb",  # from a body's frame, such as an IMU's (kalibr)
        "CAMERA_IN_BODY": "tbs timucam tbodycam bodyt tbc tic",  # EuRoC, VINS, ORB-SLAM3
        "RECTIFICATION": "rectificationmatrix rectification r",
        "PROJECTION": "projectionmatrix projection p",
    }.items()
}
_SIDES: Final = (("left", "right"), ("l", "r"), "0123456789")
"""Labels by which keys distinguish the two cameras of a pair."""
_SIDED: Final = (
    *("{0}{1}", "{1}{0}", "cam{1}{0}", "{1}cam{0}", "{0}cam{1}", "cam{0}{1}"),
    *("camera{1}{0}", "{1}camera{0}", "{0}camera{1}", "camera{0}{1}"),
)
"""Spellings of a key {0} with a side {1}, such as `cameramatrix1` and `leftk`."""
_OTHER_MEANING: Final = {
    "xi": "an omnidirectional lens (cv2.omnidir, MEI)",
    "alpha": "skew, or a lens of another model, such as EUCM (or stereoRectify's alpha: leave it "
    "out)",
    "alphac": "skew (calibrate with it fixed)",
    "skew": "skew (calibrate with it fixed)",
    "mirror": "mirrored images (calibrate with those that the camera delivers)",
    **dict.fromkeys(
        ("rotate", "rotated", "rotateimage", "imagerotation"),
        "turned images (calibrate with those that the camera delivers)",
    ),
}
"""Meaning of keys that change what the others mean, and that no camera here can have."""
_SIDE_WORDS: Final = {"", "left", "right", "l", "r", "cam", "camera"}
"""Words of a key that tell which camera it is of."""
_NO_MATTER: Final = re.compile(
    r"avg|mean|total|perview|reproj|rms|error|date|time|stamp|header|seq|frame|flag|fix|aspect"
    r"|point|board|pattern|corner|square|grid|marker|rostopic|overlap|name|serial|comment|version"
    r"|calibration(sigma|target|views)|rectif|projectionmatrix|roi|views|imagelist|imagepath|^images$"
    r"|sensortype|ratehz|rvec|tvec|criteria|extrinsicparameters|orbextractor|^viewer"
    r"|tcamimu|timucam|^(nr|num|n)?(of)?(images|pairs|shots)$|^(e|f|q|[rph][0-9]?)$"
    r"|(left|right|l|r|cam[0-9])[rp]$|^[rp](left|right|l|r)$|stereo(e|f|q)$"
)
"""Plain keys of a file that say nothing of cameras and their places, or follow from the others."""


class FoundValue(NamedTuple):
    """A value found in a calibration file."""

    value: Any
    label: str  # the file and the key, for messages
    file: str

    def expect(self, fine: object, expected: str, got: object) -> None:
        """Raise an error about this value unless it is fine."""
        if not fine:
            raise unexpected(self.label, expected, got)

    def numbers(self, counts: Sequence[int], expected: str) -> FloatArray:
        """(n,) finite numbers, n one of the counts."""
        values = parse_numbers(self.value)
        shown = self.value if values is None else values.tolist()
        got = f"{shown!r:.80}" if values is None or values.size < 10 else f"{values.size} numbers"
        if values is None or values.size not in counts:
            raise unexpected(self.label, expected, got)
        self.expect(np.isfinite(values).all(), expected, f"{got}, not all of them finite")
        return values.reshape(-1)


@dataclass(frozen=True, eq=False)
class CalibrationValues:
    """Values of calibration files, or of one camera in them, under any spelling of their keys."""

    files: tuple[str, ...]
    by_key: dict[str, list[FoundValue]]
    """Values by key in lower case without punctuation; those of other files are not found."""
    side: str = ""
    """Label of the camera of a pair whose values are found, such as `left`; or empty."""
    used: dict[str, str] = field(default_factory=dict)
    """Name of the file by label of each value found."""

    @classmethod
    def read(cls, paths: Sequence[str | os.PathLike[str]]) -> "CalibrationValues":
        """Read files, and refuse values that are not supported."""
        values = cls(tuple(os.fspath(path) for path in paths), {})
        contents = {name: _read_file(name) for name in values.files}
        if len(contents) < len(paths):
            raise unexpected(values.name, "different files", "one of them twice")
        for name, content in contents.items():
            for key, value in content:
                plain = re.sub(r"[^a-z0-9]", "", key.lower())
                if re.search(r"k\d$", plain) and isinstance(value, int | float | str):
                    plain = f"coefficient{plain}"  # of a lens; K1 is a matrix
                found = FoundValue(value, f"{name}: {key}", name)
                values.by_key.setdefault(plain, []).append(found)
        values._refuse_other_meanings()
        return values

    @property
    def name(self) -> str:
        """The files, for messages."""
        return ", ".join(self.files)

    def _spelled(self, name: str) -> Iterator[list[FoundValue]]:
        """Values of each key that spells a meaning, in order of lookup."""
        for stem in SPELLINGS.get(name, [name]):
            for form in _SIDED if self.side else _SIDED[:1]:
                found = self.by_key.get(form.format(stem, self.side), ())
                if own := [one for one in found if one.file in self.files]:
                    yield own

    def find_all(self, *names: str) -> list[FoundValue]:
        """Values of keys that say nothing without each other; empty if one is absent."""
        complete = all(any(self._spelled(name)) for name in names)
        return [found for name in names if complete and (found := self.find(name))]

    def find(self, name: str, *, shared: bool = False) -> FoundValue | None:
        """Find the value of a key of `SPELLINGS` or, plain, of another one; None if absent.

        A `shared` one may stand without a side.
        """
        found = next(self._spelled(name), None)
        if found is None:
            return replace(self, side="").find(name) if shared and self.side else None
        for other in found[1:]:
            same = _same(found[0].value, other.value)
            other.expect(same, f"what {found[0].label} says", "something else")
        self.used.update((one.label, one.file) for one in found)
        return found[0]

    def cameras(self) -> tuple[list["CalibrationValues"], "CalibrationValues"]:
        """Values of the left and right camera, or of one for both, and those of no camera alone.

        Cameras are told apart by labels in the keys, or by their files.
        """
        for sides in _SIDES:
            each = [replace(self, side=side) for side in sides]
            found = [one for one in each if any(one._spelled("MATRIX"))]
            if len(found) > 2:
                raise ConfigurationError(
                    f"{self.name}: expected one or two cameras, got those of "
                    f"{', '.join(one.side for one in found)} (as in cam0): leave only the two that "
                    "are the eyes in the file"
                )
            if len(found) == 2:
                return found, self
        each = [replace(self, files=(name,)) for name in self.files]
        found = [one for one in each if any(one._spelled("MATRIX"))]
        if len(found) not in (1, 2):
            raise ConfigurationError(
                f"{self.name}: expected the camera matrices of one or two cameras (such as "
                f"cameraMatrix1 and cameraMatrix2, or camera_matrix in a file for each), got "
                f"{len(found)} of them; {READ_FORMATS}"
            )
        others = tuple(one.name for one in each if one not in found)
        return found, self if len(found) == 1 else replace(self, files=others)

    def _refuse_other_meanings(self) -> None:
        """Refuse a value that changes the meaning of others and that is not supported."""
        for found in chain.from_iterable(self.by_key.values()):
            key = found.label.removeprefix(f"{found.file}: ").rpartition(".")[2]
            spaced = re.sub(r"(?<=[a-z])(?=[A-Z0-9])", "_", key).lower()
            words = [word for word in re.split(r"[^a-z]+", spaced) if word not in _SIDE_WORDS]
            mirrors = any(re.match(r"mirror|[hv]?flip", word) for word in words)
            if meaning := _OTHER_MEANING.get("mirror" if mirrors else "".join(words)):
                numbers = parse_numbers(found.value)
                off = str(found.value).lower() in ("false", "no", "none", "off", "")
                if numbers is not None:  # -1 is stereoRectify's default
                    off = off or not numbers.any() or ("alpha" in words and (numbers == -1.0).all())
                expected = "a calibration of a pinhole or fisheye camera as OpenCV has them"
                got = f"{found.value!r:.60}: {meaning}; this is not supported"
                found.expect(off, expected, got)
                self.used[found.label] = ""  # said, of no effect

    def notes(self) -> tuple[str, ...]:
        """Refuse files that nothing was read of, and name keys that nothing asked for."""
        used = set(self.used.values())
        if others := [name for name in self.files if name not in used]:
            enough = ", ".join(name for name in self.files if name in used)
            got = f"a calibration in {enough} that uses nothing else"
            raise unexpected(", ".join(others), "files that belong together", got)
        unread = [
            one.label
            for key, found in self.by_key.items()
            for one in found
            if one.label not in self.used and not _NO_MATTER.search(key)
        ]
        more = f" and {len(unread) - _MAX_UNREAD} more" if len(unread) > _MAX_UNREAD else ""
        said = f"these keys are not read: {', '.join(unread[:_MAX_UNREAD])}{more}"
        return (said,) if unread else ()


def _same(one: Any, other: Any) -> bool:
    first, second = parse_numbers(one), parse_numbers(other)
    if first is None or second is None:
        return first is second and str(one) == str(other)
    return bool(np.array_equal(first, second))
