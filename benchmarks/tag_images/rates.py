"""How many tags are found in whole photographs beside the AprilTag library, and what is refused.

Run ``python -m benchmarks.tag_images.rates FOLDER --family 36h11 25h9``, with ``--json FILE`` to
keep the list. Nothing needs to be known of the photographs: what two detectors find of one number
at one place is one tag. Each folder in the folder has a row for each family of which anything is
found in it. The library counts with and without its sharpening, as one detector that has what
either finds; it sees grey levels, ours the colours of the file as well.

Below the table are listed the tags that only one of both finds. Look at them: the library reads
tags in clutter too, most of them with wrong bits or a small margin. For what ours lacks, the list
says how the best fit near it came out, or nothing where ours had no square there to fit. With 16h5
the library reads so many tags in clutter that ``--margin 10`` or more is needed.
"""

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.tag_images.methods import Found, Method, make_methods
from benchmarks.tag_images.photographs import edge, image_paths
from benchmarks.tag_images.scores import near_px
from vergence.errors import VergenceError
from vergence.models.boards import TagFamily
from vergence.vision import as_grey, parse_target
from vergence.vision.image import read_pixels
from vergence.vision.tags.detector import TagDetector
from vergence.vision.tags.report import TagFit

_LIBRARY = ("pyapriltags", "pyapriltags+sharpening")
_NEAR_EDGES = 0.5
"""A fit this near to where the library has the tag was an attempt at it."""


class RecordingDetector(TagDetector):
    """A detector of tags that keeps how each of its fits came out."""

    def __init__(self, target: TagFamily) -> None:
        super().__init__(target)
        self.fits: list[tuple[int, NDArray[np.float64], TagFit]] = []
        """Of the last image: the number, about where its middle is, px, and the fit."""

    def _fit(self, image: Any, corners: Any, identity: int, *others: Any) -> Any:
        found, fit = super()._fit(image, corners, identity, *others)
        self.fits.append((identity, np.mean(corners, axis=0), fit))
        return found, fit

    def found(self, image: NDArray[Any]) -> list[Found]:
        """All tags of an image, grey or BGR."""
        self.fits.clear()
        return [
            Found(each.target.id, each.point_px, each.corners_px)
            for each in self.detect_all(image)
            if not isinstance(each.target, TagFamily)
        ]

    def best_fit(self, tag: Found) -> TagFit | None:
        """The best of the fits of the last image that tried a tag; None where none did."""
        reach = _NEAR_EDGES * edge(tag.corners_px)
        tried = [
            fit
            for number, middle, fit in self.fits
            if number == tag.id and np.linalg.norm(middle - tag.centre_px) < reach
        ]
        return max(tried, key=lambda fit: fit.explained, default=None)


@dataclass(frozen=True)
class Seen:
    """A tag of a photograph, and who finds it."""

    image: str
    tag: Found
    """As the library has it, if it does."""
    ours: bool
    library: tuple[bool, ...]
    """Without its sharpening, and with it."""
    fit: TagFit | None = None
    """The best of ours, where only the library finds it."""

    @property
    def row(self) -> dict[str, Any]:
        """As a JSON object."""
        corners = self.tag.corners_px
        row: dict[str, Any] = {
            "image": self.image,
            "id": self.tag.id,
            "by": "vergence" if self.ours else "library",
            "at_px": [round(float(value), 1) for value in self.tag.centre_px],
            "edge_px": round(edge(corners), 1),
            "wrong_bits": self.tag.wrong_bits,
            "margin": None if self.tag.margin is None else round(self.tag.margin, 1),
        }
        if self.fit is not None:
            fit = self.fit
            row["fit"] = {
                "contrast": round(fit.contrast, 1),
                "explained": round(fit.explained, 3),
                "wrong": fit.reading.wrong,
                "frame": fit.reading.frame,
                "unclear": round(fit.reading.unclear, 3),
                "moved_px": round(fit.moved_px, 2),
                "sigma_px": round(fit.sigma_px, 3),
            }
        return row


def seen_in(
    name: str,
    image: NDArray[Any],
    ours: RecordingDetector,
    library: Sequence[Method],
    least_margin: float = 0.0,
) -> list[Seen]:
    """The tags that ours or the library finds in an image.

    Args:
        name: of the image.
        image: (height, width) grey levels or (height, width, 3) BGR.
        ours: of the same family as the library's.
        library: its detectors.
        least_margin: of what the library finds alone, grey levels; with less it does not count.
    """
    places: list[tuple[Found, set[str]]] = []
    grey = as_grey(image)
    for method in library:
        for tag in method.detect(grey):
            _put(places, tag, method.name)
    for tag in ours.found(image):
        _put(places, tag, "vergence")
    return [
        Seen(
            name,
            tag,
            "vergence" in by,
            tuple(method.name in by for method in library),
            None if "vergence" in by else ours.best_fit(tag),
        )
        for tag, by in places
        if "vergence" in by or tag.margin is None or tag.margin >= least_margin
    ]


def _put(places: list[tuple[Found, set[str]]], tag: Found, name: str) -> None:
    for other, by in places:
        off = float(np.linalg.norm(tag.centre_px - other.centre_px))
        if other.id == tag.id and name not in by and off <= near_px(edge(other.corners_px)):
            by.add(name)
            return
    places.append((tag, {name}))


def folders(folder: Path) -> Iterator[tuple[str, list[Path]]]:
    """The images of each folder in a folder, and of itself.

    Raises:
        VergenceError: there are no images.
    """
    paths = image_paths(folder)
    names = [path.relative_to(folder).parts for path in paths]
    for name in sorted({parts[0] if len(parts) > 1 else "." for parts in names}):
        yield (
            name,
            [
                path
                for path, parts in zip(paths, names, strict=True)
                if name == (parts[0] if len(parts) > 1 else ".")
            ],
        )


def cells(seen: Sequence[Seen]) -> list[int]:
    """The counts of a row of the table."""
    both = sum(one.ours and any(one.library) for one in seen)
    ours = sum(one.ours for one in seen)
    library = sum(any(one.library) for one in seen)
    return [
        ours,
        library,
        *(sum(column) for column in zip(*(one.library for one in seen), strict=True)),
        both,
        ours - both,
        library - both,
        sum(not one.ours and not one.tag.wrong_bits for one in seen),
    ]


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse, look, print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.tag_images.rates")
    parser.add_argument("folder", type=Path, help="photographs, in a folder for each source")
    parser.add_argument("--family", nargs="+", default=["36h11"], help="(default: 36h11)")
    parser.add_argument(
        "--margin", type=float, default=0.0, help="least one of the library's own findings"
    )
    parser.add_argument("--json", type=Path, help="file for the tags that one alone finds")
    given = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    lines, listed = [], []
    try:
        for family in given.family:
            ours = RecordingDetector(parse_target(f"tag:{family}"))
            library = make_methods(_LIBRARY, family, lambda text: print(text, file=sys.stderr))
            if not library:
                parser.error("expected the package pyapriltags, which is not installed")
            for name, paths in folders(given.folder):
                print(f"{family}: {len(paths)} images of {name}", file=sys.stderr, flush=True)
                seen = [
                    one
                    for path in paths
                    for one in seen_in(str(path), read_pixels(path), ours, library, given.margin)
                ]
                if seen:
                    counts = " | ".join(map(str, cells(seen)))
                    lines.append(f"| {name} | {family} | {len(paths)} | {counts} |")
                alone = [one for one in seen if not (one.ours and any(one.library))]
                listed += [{"folder": name, "family": family, **one.row} for one in alone]
    except VergenceError as error:
        parser.error(str(error))
    print("| folder | family | images | vergence | library | plain | sharpened | both |", end="")
    print(" vergence alone | library alone | of these, no wrong bits |")
    print("|---|---|" + "---:|" * 9)
    print("\n".join(lines) + "\n")
    for row in sorted(
        listed, key=lambda row: (row["by"], row["wrong_bits"], -(row["margin"] or 0))
    ):
        print("  " + ", ".join(f"{key} {value}" for key, value in row.items()))
    if given.json is not None:
        given.json.write_text(json.dumps(listed, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
