"""Which photograph of the left eye and which of the right one were taken together, by their names.

Two images are a pair if their names, without the ending, are equal once the word that tells the
side is taken away: `left` and `right`, `l` and `r`, or `cam0` and `cam1`, in either case. The word
stands by itself: no letter touches it, except where the case changes as in `imageLeft12`. Where
both folders have the same names, no word is needed.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

from vergence.errors import ConfigurationError
from vergence.perception.photographs import check_there, photographs_in, some_of

_WORDS: Final = (("left", "right"), ("l", "r"), ("cam0", "cam1"), ("camera0", "camera1"))
"""What tells the sides of a pair, left first; a longer word before a shorter one."""
_SIDE: Final = "\0"
"""Stands in a name for the word that tells the side."""


class ImagePair(NamedTuple):
    """Two photographs of the same moment."""

    left: Path
    right: Path

    @property
    def name(self) -> str:
        """The name of the left image."""
        return self.left.name


class Pairs(NamedTuple):
    """The pairs of two folders."""

    pairs: list[ImagePair]
    """In the order of the left images' names."""
    alone: list[Path]
    """Images without a partner, those of the left folder first."""
    single: bool
    """Whether two files were given, not folders."""


def pair_up(left: Path, right: Path) -> Pairs:
    """The pairs of two images or two folders.

    Args:
        left: an image, or a folder of the left eye's images.
        right: the same of the right eye. It may be the same folder, where names tell the sides.

    Raises:
        ConfigurationError: one is not there, one is a file and the other a folder, a folder has no
            images, no image has a partner, or one has two.
    """
    for place in (left, right):
        check_there(place)
    if not left.is_dir() and not right.is_dir():
        return Pairs([ImagePair(left, right)], [], True)
    if not (left.is_dir() and right.is_dir()):
        folder, other = (left, right) if left.is_dir() else (right, left)
        raise ConfigurationError(
            f"expected two images or two folders, got the folder {folder} and {other}"
        )
    return pair_images(
        photographs_in(left), photographs_in(right), same=left.resolve() == right.resolve()
    )


def pair_images(lefts: Sequence[Path], rights: Sequence[Path], *, same: bool = False) -> Pairs:
    """The pairs of two lists of images.

    Args:
        lefts: images of the left eye.
        rights: images of the right eye.
        same: whether both lists are of the same images, whose names have to tell the sides.

    Raises:
        ConfigurationError: no image has a partner, or one has two.
    """
    by_key: dict[str, list[Path]] = {}
    for path in rights:
        for key in _keys(path, 1, same):
            by_key.setdefault(key, []).append(path)
    pairs: list[ImagePair] = []
    taken: dict[Path, Path] = {}
    for path in lefts:
        found = next((by_key[key] for key in _keys(path, 0, same) if key in by_key), [])
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
            f"at all, got {some_of(p.name for p in lefts)} in {lefts[0].parent} and "
            f"{some_of(p.name for p in rights)} in {rights[0].parent}"
        )
    paired = {path for pair in pairs for path in pair}
    everyone = list(lefts) if same else [*lefts, *rights]
    return Pairs(pairs, [path for path in everyone if path not in paired], False)


def _keys(path: Path, eye: int, told: bool) -> list[str]:
    """What a name may be called without its side, the likeliest first.

    Args:
        path: the image.
        eye: 0 for left, 1 for right.
        told: whether the name has to tell the side.
    """
    keys = [] if told else [path.stem]
    for words in _WORDS:
        for start, end in _places(path.stem, words[eye]):
            # with the kind of the word, so that `l` goes with `r` alone
            keys.append(f"{path.stem[:start]}{_SIDE}{words[0]}{_SIDE}{path.stem[end:]}")
    return keys


def _places(stem: str, word: str) -> list[tuple[int, int]]:
    """Where a word stands by itself in a name, the last place first."""
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
