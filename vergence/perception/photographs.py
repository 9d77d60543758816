"""Photographs of both eyes: reading them, pairing them by name, and their joint angles."""

import csv
import glob
import io
import json
import math
import re
import tomllib
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from vergence.errors import ConfigurationError, UnreadableFileError
from vergence.models.head import HeadModel
from vergence.models.parts import EYES, NECK, FloatArray

SUFFIXES: Final = (
    ".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm", ".pnm", ".jp2",
)  # fmt: skip
"""Extensions of files that count as photographs; other files of a folder are ignored."""


def natural_sort_key(path: Path) -> tuple[object, ...]:
    """Sort key that treats numbers in names as numbers: `left2` comes before `left10`."""
    # after the split, texts and numbers alternate, so that only like parts are compared
    parts = re.split(r"(\d+)", path.name)
    return tuple(int(part) if i % 2 else part.lower() for i, part in enumerate(parts)), path.name


def photographs_in_folder(folder: Path) -> list[Path]:
    """List the image files directly in a folder, sorted by `natural_sort_key`."""
    try:
        there = [path for path in folder.iterdir() if not path.name.startswith(".")]
    except OSError as error:
        raise ConfigurationError(f"{folder}: {error.strerror or error}") from error
    found = [path for path in there if path.suffix.lower() in SUFFIXES]
    if not found:
        raise ConfigurationError(
            f"{folder}: expected a folder with images ({', '.join(SUFFIXES)}) right in it, got "
            f"{f'none among {len(there)} files' if there else 'an empty one'}"
        )
    return sorted(found, key=natural_sort_key)


def require_existing(path: Path) -> None:
    """Raise an error if a path does not exist."""
    try:
        there = path.exists()
    except (OSError, ValueError):  # e.g. a name that is too long: reading it raises a clear error
        there = True
    if not there:
        raise ConfigurationError(
            f"{path}: no such file or folder; expected an image, or a folder of images"
        )


def list_photographs(paths: Sequence[Path]) -> list[Path]:
    """List given files, photographs in given folders, and files that match unexpanded patterns."""
    found: list[Path] = []
    for place in paths:
        if glob.has_magic(str(place)) and not place.exists():
            matches = sorted(map(Path, glob.glob(str(place), recursive=True)), key=natural_sort_key)
            if not matches:
                raise ConfigurationError(f"expected images, got none that match {place}")
            found += matches
            continue
        require_existing(place)
        found += photographs_in_folder(place) if place.is_dir() else [place]
    return found


def join_first_names(names: Iterable[str], most: int = 5) -> str:
    """Join names for a message: the first few (chosen: legibility), and how many more there are."""
    every = list(names)
    said = ", ".join(every[:most])
    return said if len(every) <= most else f"{said} and {len(every) - most} more"


_SIDE_WORDS: Final = (("left", "right"), ("l", "r"), ("cam0", "cam1"), ("camera0", "camera1"))
"""Words for the sides of a pair, left first."""
_SIDE_PLACEHOLDER: Final = "\0"
"""Placeholder in a name for the word for the side."""


class ImagePair(NamedTuple):
    """Two photographs of the same moment."""

    left: Path
    right: Path

    @property
    def name(self) -> str:
        """Name of the left image."""
        return self.left.name


class PairedImages(NamedTuple):
    """The pairs of two folders."""

    pairs: list[ImagePair]
    """In the order of the left images' names."""
    unpaired: list[Path]
    """Images without a partner, those of the left folder first."""


def pair_up(left: Path, right: Path) -> PairedImages:
    """Pair two images, or those of two folders (or of one, by words for the sides in names)."""
    for place in (left, right):
        require_existing(place)
    if not left.is_dir() and not right.is_dir():
        return PairedImages([ImagePair(left, right)], [])
    if not (left.is_dir() and right.is_dir()):
        folder, other = (left, right) if left.is_dir() else (right, left)
        raise ConfigurationError(
            f"expected two images or two folders, got the folder {folder} and {other}"
        )
    return pair_images(
        photographs_in_folder(left),
        photographs_in_folder(right),
        one_folder=left.resolve() == right.resolve(),
    )


def pair_images(
    lefts: Sequence[Path], rights: Sequence[Path], *, one_folder: bool = False
) -> PairedImages:
    """Pair the images of two lists; with `one_folder`, names need a word for the side."""
    by_key: dict[str, list[Path]] = defaultdict(list)
    for path in rights:
        for key in _keys(path, 1, one_folder):
            by_key[key].append(path)
    taken: dict[Path, Path] = {}  # left image by its right one
    for path in lefts:
        found = next((by_key[key] for key in _keys(path, 0, one_folder) if key in by_key), [])
        rivals = [(path, found)] if len(found) > 1 else []
        rivals += [(one, [taken[one], path]) for one in found if one in taken]
        for image, (first, second, *_) in rivals:
            raise ConfigurationError(
                f"{image}: expected one image that belongs to it, got {first} and {second}"
            )
        taken |= dict.fromkeys(found, path)
    pairs = [ImagePair(left, right) for right, left in taken.items()]
    if not pairs:
        swapped = {key for path in lefts for key in _keys(path, 1, True)}
        if swapped.intersection(key for path in rights for key in _keys(path, 0, True)):
            raise ConfigurationError(
                f"expected the left eye's images before the right one's, got {lefts[0]} and "
                f"{rights[0]}: by their names they are the other way round"
            )
        raise ConfigurationError(
            "expected images whose names differ by left and right, l and r, cam0 and cam1 or not "
            f"at all, got {join_first_names(p.name for p in lefts)} in {lefts[0].parent} and "
            f"{join_first_names(p.name for p in rights)} in {rights[0].parent}"
        )
    everyone = lefts if one_folder else [*lefts, *rights]
    paired = {*taken, *taken.values()}
    return PairedImages(pairs, [path for path in everyone if path not in paired])


def _keys(path: Path, eye: int, side_required: bool) -> list[str]:
    """Possible keys of an image: its name without the word for the side, the likeliest first."""
    stem = path.stem
    keys = [] if side_required else [stem]
    for words in _SIDE_WORDS:
        # the key holds the kind of word, so that `l` matches only `r`
        side = f"{_SIDE_PLACEHOLDER}{words[0]}{_SIDE_PLACEHOLDER}"
        matches = list(re.finditer(re.escape(words[eye]), stem, re.IGNORECASE))
        keys += [
            f"{stem[: match.start()]}{side}{stem[match.end() :]}"
            for match in reversed(matches)
            if _is_word(match[0], stem[: match.start()][-1:], stem[match.end() :][:1])
        ]
    return keys


def _is_word(text: str, before: str, after: str) -> bool:
    """True if a text is a word of its own between two characters, which may be empty."""
    if before.isalpha() and not (before.islower() and text[0].isupper()):
        return False
    if text[-1].isdigit():
        return not after.isalnum()
    return not after.isalpha() or (text[-1].islower() and after.isupper())


Row = dict[str, Any]
"""Values by their names."""
PAIR: Final = "pair"
"""Column that holds the name of a row's pair."""
_FORMATS: Final = "JSON, CSV or TOML (by its ending)"


def read_table_rows(path: Path) -> list[Row]:
    """Rows, at least one, of JSON or TOML (table, list, or tables by pair) or CSV (strings)."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise UnreadableFileError(str(path), error.strerror or error, _FORMATS) from error
    except UnicodeDecodeError as error:
        raise UnreadableFileError(str(path), "no text in UTF-8", _FORMATS) from error
    kind = path.suffix.lower()
    rows: list[Any]
    try:
        if kind == ".csv":
            rows = _of_csv(text)
        elif kind in (".json", ".toml"):
            rows = _of_tables(json.loads(text) if kind == ".json" else tomllib.loads(text))
        else:
            raise ConfigurationError(f"{path}: expected {_FORMATS}, got the ending {kind!r}")
    except (ValueError, RecursionError, csv.Error) as error:
        raise ConfigurationError(
            f"{path}: expected {kind[1:].upper()}, got what cannot be read: {error!s:.200}"
        ) from error
    if not rows or not all(isinstance(row, dict) and row for row in rows):
        raise ConfigurationError(
            f"{path}: expected a row of joint angles for all pairs, or one for each with its "
            f"name as {PAIR!r}, got {'none' if not rows else 'something else'}"
        )
    return rows


def _of_csv(text: str) -> list[Row]:
    rows: list[Row] = []
    for row in csv.DictReader(io.StringIO(text), skipinitialspace=True):
        if None in row or None in row.values():
            raise ValueError(f"row {len(rows) + 1} has another number of values than the head")
        rows.append({name.strip(): value.strip() for name, value in row.items()})
    return rows


def _of_tables(content: Any) -> list[Any]:
    if not isinstance(content, dict):
        return content if isinstance(content, list) else []
    values = list(content.values())
    if len(values) == 1 and isinstance(values[0], list):
        return values[0]
    if values and all(isinstance(value, dict) for value in values):
        return [{PAIR: name, **value} for name, value in content.items()]
    return [content]


_LIMIT_TOLERANCE_RAD: Final = 0.1
"""Tolerance of a joint's limits, rad: encoders have an offset, and limits are rounded (chosen:
these against angles in the wrong unit)."""
_RADIANS_PER_SUFFIX: Final = {"_rad": 1.0, "_deg": math.pi / 180.0, "": 1.0}
"""Units of columns by the suffix after a joint's name; a joint's own name counts first, so last."""


def read_joint_angles(
    head: HeadModel, file: Path | None, pairs: Sequence[str]
) -> Mapping[str, FloatArray]:
    """Joint angles (7,) by pair, rad, from JSON, CSV or TOML; a head at rest without a file."""
    if file is None:
        return dict.fromkeys(pairs, head.rest())
    rows = read_pair_rows(file, pairs)
    return {pair: parse_joint_angles(head, row, f"{file}: {pair}") for pair, row in rows.items()}


def read_pair_rows(file: Path, pairs: Sequence[str]) -> Mapping[str, Row]:
    """Rows by pair, without the column `pair`, see `read_joint_angles`."""
    rows = read_table_rows(file)
    if len(rows) == 1 and PAIR not in rows[0]:
        return dict.fromkeys(pairs, rows[0])
    by_pair: dict[str, Row] = {}
    for number, row in enumerate(rows, 1):
        name = str(row.pop(PAIR, ""))
        if not name:
            raise ConfigurationError(
                f"{file}: expected the name of the left image as {PAIR!r} in each of the "
                f"{len(rows)} rows, got none in row {number}"
            )
        if name in by_pair:
            raise ConfigurationError(f"{file}: expected one row for each pair, got two of {name!r}")
        by_pair[name] = row
    found = {}
    for pair in pairs:
        name = pair if pair in by_pair else Path(pair).stem
        if name not in by_pair:
            raise ConfigurationError(
                f"{file}: expected a row whose {PAIR!r} is {pair!r}, got "
                f"{join_first_names(by_pair)}"
            )
        found[pair] = by_pair[name]
    return found


def parse_joint_angles(head: HeadModel, row: Row, where: str) -> FloatArray:
    """(7,) rad, of a row by joints or actuators (`_deg`: degrees); `where` is for messages."""
    given = _radians(head, row, where)
    own = head.actuation
    joints = [name for name in dict.fromkeys(head.joints[EYES]) if name]
    lacking = [name for name in joints if name not in given]
    q = np.array([given.get(n, a) for n, a in zip(head.joints, head.rest(), strict=True)])
    if lacking:
        if not own.count or not all(name in given for name in own.names):
            raise ConfigurationError(
                f"{where}: expected the angles of {', '.join(joints)}, got none of "
                f"{', '.join(lacking)}"
            )
        actuators = np.zeros(7)
        actuators[NECK] = q[NECK]
        actuators[EYES][: own.count] = [given[name] for name in own.names]
        q = own.joints_of(actuators)
    lowest, highest = head.limits.lower, head.limits.upper
    allowed = (lowest - _LIMIT_TOLERANCE_RAD <= q) & (q <= highest + _LIMIT_TOLERANCE_RAD)
    for name, good, angle, low, high in zip(head.joints, allowed, q, lowest, highest, strict=True):
        if name and not good:
            raise ConfigurationError(
                f"{where}: {name}: expected {low:.4g} to {high:.4g} rad, got {angle:.4g} "
                f"(an angle in degrees is named {name}_deg)"
            )
    return q


def _radians(head: HeadModel, row: Row, where: str) -> dict[str, float]:
    """Angles of a row by the names of joints and actuators, rad."""
    names = dict.fromkeys(name for name in (*head.joints, *head.actuation.names) if name)
    columns = {
        f"{name}{suffix}": (name, unit)
        for suffix, unit in _RADIANS_PER_SUFFIX.items()
        for name in names
    }
    found: dict[str, float] = {}
    for column, value in row.items():
        if column not in columns:
            raise ConfigurationError(
                f"{where}: expected joints among {', '.join(names) or 'none (a fixed pair)'}, "
                f"got {column!r:.80}"
            )
        name, unit = columns[column]
        if name in found:
            raise ConfigurationError(f"{where}: expected {name} once, got it twice")
        found[name] = unit * parse_finite_number(value, f"{where}: {column}")
    return found


def parse_finite_number(value: Any, where: str) -> float:
    """Convert a table's value to a finite number."""
    if not isinstance(value, bool) and isinstance(value, int | float | str):
        try:
            number = float(value)
        except (ValueError, OverflowError):
            number = math.nan
        if math.isfinite(number):
            return number
    raise ConfigurationError(f"{where}: expected a number, got {value!r:.80}")
