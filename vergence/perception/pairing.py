"""Pair photographs of the left and the right eye by their names.

Two images are a pair if their names, without the extension, are equal after the word for the side
is removed: `left` and `right`, `l` and `r`, `cam0` and `cam1`, or `camera0` and `camera1`, in upper
or lower case. The word must be separate: no letter is next to it, except if the case changes there,
as in `imageLeft12`. If both folders use the same names, no such word is needed.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

from vergence.errors import ConfigurationError
from vergence.perception.photographs import (
    join_first_names,
    photographs_in_folder,
    require_existing,
)

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
    single: bool
    """True if two files were given, not folders."""


def pair_up(left: Path, right: Path) -> PairedImages:
    """Pair two images, or those of two folders (or of one, by words for the sides in names)."""
    for place in (left, right):
        require_existing(place)
    if not left.is_dir() and not right.is_dir():
        return PairedImages([ImagePair(left, right)], [], True)
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
    by_key: dict[str, list[Path]] = {}
    for path in rights:
        for key in _keys(path, 1, one_folder):
            by_key.setdefault(key, []).append(path)
    pairs: list[ImagePair] = []
    taken: dict[Path, Path] = {}
    for path in lefts:
        found = next((by_key[key] for key in _keys(path, 0, one_folder) if key in by_key), [])
        if len(found) > 1:
            raise ConfigurationError(
                f"{path}: expected one image that belongs to it, got {found[0]} and {found[1]}"
            )
        for partner in found:
            if partner in taken:
                raise ConfigurationError(
                    f"{partner}: expected one image that belongs to it, got {taken[partner]} "
                    f"and {path}"
                )
            taken[partner] = path
            pairs.append(ImagePair(path, partner))
    swapped = (
        {key for path in side for key in _keys(path, eye, True)}
        for eye, side in enumerate((rights, lefts))
    )
    if not pairs and set.intersection(*swapped):
        raise ConfigurationError(
            f"expected the left eye's images before the right one's, got {lefts[0]} and "
            f"{rights[0]}: by their names they are the other way round"
        )
    if not pairs:
        raise ConfigurationError(
            "expected images whose names differ by left and right, l and r, cam0 and cam1 or not "
            f"at all, got {join_first_names(p.name for p in lefts)} in {lefts[0].parent} and "
            f"{join_first_names(p.name for p in rights)} in {rights[0].parent}"
        )
    paired = {path for pair in pairs for path in pair}
    everyone = list(lefts) if one_folder else [*lefts, *rights]
    return PairedImages(pairs, [path for path in everyone if path not in paired], False)


def _keys(path: Path, eye: int, side_required: bool) -> list[str]:
    """Possible keys of an image: its name without the word for the side, the likeliest first."""
    keys = [] if side_required else [path.stem]
    for words in _SIDE_WORDS:
        for start, end in _places(path.stem, words[eye]):
            # the key holds the kind of word, so that `l` matches only `r`
            keys.append(
                f"{path.stem[:start]}{_SIDE_PLACEHOLDER}{words[0]}{_SIDE_PLACEHOLDER}{path.stem[end:]}"
            )
    return keys


def _places(stem: str, word: str) -> list[tuple[int, int]]:
    """Positions at which a word is separate in a name, the last one first."""
    found = []
    for match in re.finditer(re.escape(word), stem, re.IGNORECASE):
        before, text, after = stem[: match.start()][-1:], match[0], stem[match.end() :][:1]
        begins = not before.isalpha() or (before.islower() and text[0].isupper())
        ends = not after.isalpha() or (text[-1] != text[-1].upper() and after.isupper())
        if text[-1].isdigit():
            ends = not after.isalnum()
        if begins and ends:
            found.append(match.span())
    return found[::-1]
