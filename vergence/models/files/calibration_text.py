"""Parse the text of a calibration file, YAML, XML or JSON, into nested mappings.

OpenCV's FileStorage writes all three. Its YAML has a directive and tags of its own; ROS and
kalibr write ordinary YAML, which FileStorage does not read.
"""

import json
import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import accumulate
from pathlib import Path
from typing import Any, Final
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
