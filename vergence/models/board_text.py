"""Parser of targets in their text form: `tag:36h11:5:120`, `checkerboard:9x6:24.23`."""

import math
import re
from collections.abc import Callable
from typing import Final

from vergence.errors import ConfigurationError, UnknownNameError
from vergence.models.april_grid import AprilGrid
from vergence.models.boards import AprilTag, CharucoBoard, Checkerboard, TagFamily, Target

_LONGEST: Final = 100
"""Longest text that is parsed, characters (chosen: far above any target, short enough for a
message)."""
_FORMS: Final = {
    "tag": "tag:FAMILY[:ID[:EDGE]], such as tag:36h11:5:120 (black edge in mm) or tag:36h11",
    "checkerboard": "checkerboard:COLUMNSxROWS[:SQUARE], such as checkerboard:9x6:24.23 "
    "(inner corners, square in mm)",
    "charuco": "charuco:COLUMNSxROWS:SQUARE:MARKER:DICT, such as charuco:7x5:40:30:4X4_50 "
    "(squares, lengths in mm), with :legacy at the end for a board of OpenCV before 4.6",
    "aprilgrid": "aprilgrid:COLUMNSxROWS:TAG:SPACING, such as aprilgrid:6x6:88:0.3 (kalibr's "
    "tagCols, tagRows, tagSize in mm and tagSpacing)",
}


def parse_target(text: str) -> Target:
    """Parse the text form of a target.

    Args:
        text: `tag:FAMILY[:ID[:EDGE]]`, `checkerboard:COLUMNSxROWS[:SQUARE]`,
            `charuco:COLUMNSxROWS:SQUARE:MARKER:DICT[:legacy]` or
            `aprilgrid:COLUMNSxROWS:TAG:SPACING`; lengths in mm. COLUMNS and ROWS count the inner
            corners of a checkerboard, the squares of a ChArUco board, and the tags of an
            AprilGrid. SPACING is the gap between two tags as a fraction of a tag's edge.

    Returns:
        The target. Without a size in the text it has the default size and `size_known` is False.

    Raises:
        ConfigurationError: the text has none of these forms, or a value is invalid.
    """
    text = str(text).strip()
    kind, *parts = text.split(":")
    read = _READERS.get(kind.strip().lower())
    if read is None and text.isprintable():
        raise ConfigurationError(
            "target: expected a printed board, such as checkerboard:9x6:24, "
            "charuco:7x5:40:30:4X4_50, aprilgrid:6x6:88:0.3 or tag:36h11:0:120 (lengths in mm; "
            "`vergence print-target` prints it); nothing else can be looked at, such as a face or "
            f"a ball; got {text!r:.100}"
        )
    if read is None or len(text) > _LONGEST or not text.isprintable():
        raise ConfigurationError(
            f"target: expected {'; or '.join(_FORMS.values())}; got {text!r:.100}"
        )
    try:
        return read([part.strip() for part in parts])
    except _FormError:
        form = _FORMS[kind.strip().lower()]
        raise ConfigurationError(f"target: expected {form}; got {text!r:.100}") from None
    except (ConfigurationError, UnknownNameError) as error:
        raise ConfigurationError(f"target {text[:100]}: {error}") from error


class _FormError(Exception):
    """Raised if a part of the text does not have the expected form."""


def _tag(parts: list[str]) -> Target:
    if not 1 <= len(parts) <= 3:
        raise _FormError
    known = len(parts) == 3
    edge_m = _length(parts[2]) if known else AprilTag.edge_m
    if len(parts) == 1 or parts[1] in ("", "*"):
        return TagFamily(family=parts[0], edge_m=edge_m, size_known=known)
    return AprilTag(family=parts[0], id=_count(parts[1]), edge_m=edge_m, size_known=known)


def _checkerboard(parts: list[str]) -> Target:
    if not 1 <= len(parts) <= 2:
        raise _FormError
    columns, rows = _counts(parts[0])
    if len(parts) == 1:
        return Checkerboard(columns=columns, rows=rows, size_known=False)
    return Checkerboard(columns=columns, rows=rows, square_m=_length(parts[1]))


def _charuco(parts: list[str]) -> Target:
    legacy = len(parts) == 5 and parts[4].lower() == "legacy"
    if len(parts) != 4 + legacy:
        raise _FormError
    columns, rows = _counts(parts[0])
    return CharucoBoard(
        columns=columns,
        rows=rows,
        square_m=_length(parts[1]),
        marker_m=_length(parts[2]),
        dictionary=parts[3],
        legacy=legacy,
    )


def _april_grid(parts: list[str]) -> Target:
    if len(parts) != 3:
        raise _FormError
    columns, rows = _counts(parts[0])
    return AprilGrid(
        columns=columns, rows=rows, tag_m=_length(parts[1]), spacing=_positive(parts[2])
    )


_READERS: Final[dict[str, Callable[[list[str]], Target]]] = {
    "tag": _tag,
    "checkerboard": _checkerboard,
    "charuco": _charuco,
    "aprilgrid": _april_grid,
}


def _counts(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,4})\s*[xX×]\s*(\d{1,4})", text)
    if match is None:
        raise _FormError
    return int(match[1]), int(match[2])


def _count(text: str) -> int:
    if re.fullmatch(r"\d{1,9}", text) is None:
        raise _FormError
    return int(text)


def _length(text: str) -> float:
    """Parse a length in millimetres; returns metres."""
    return _positive(text) / 1000.0


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise _FormError from None
    if not (math.isfinite(value) and value > 0.0):
        raise _FormError
    return value
