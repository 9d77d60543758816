"""Compare the tags found in whole photographs with those of the AprilTag library.

Run ``python -m benchmarks.tag_images.rates FOLDER --family 36h11 25h9``, with ``--json FILE`` to
keep the list. The photographs need no ground truth: detections of two detectors with the same
number at the same place count as one tag. Each subfolder has a row for each family of which a tag
is found in it. The library runs with and without sharpening, and the union counts as its
detections. It receives grey levels; our detector also receives the colours of the file.

Below the table are listed the tags that only one of the two finds. Look at them: the library also
reads false tags in clutter, most of them with wrong bits or a small margin. For tags that ours
misses, the list states the result of the best fit near them, or nothing if ours had no square
there to fit. With 16h5 the library reads so many tags in clutter that ``--margin 10`` or more is
needed.
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
from vergence.vision import as_grey, parse_target
from vergence.vision.image import read_pixels
from vergence.vision.tags.detector import TagDetector
from vergence.vision.tags.fit import TagFit
from vergence.vision.targets import TagFamily

_LIBRARY = ("pyapriltags", "pyapriltags+sharpening")
_NEAR_EDGES = 0.5
"""Largest distance of our fit from the library's tag to count as an attempt at it, tag edges."""


class RecordingDetector(TagDetector):
    """Tag detector that keeps the result of each of its fits."""

    def __init__(self, target: TagFamily) -> None:
        super().__init__(target)
        self.fits: list[tuple[int, NDArray[np.float64], TagFit]] = []
        """Fits of the last image: tag number, approximate centre, px, and result."""

    def _fit_once(self, frame: Any, corners: Any, identity: int, *others: Any) -> Any:
        found, fit = super()._fit_once(frame, corners, identity, *others)
        self.fits.append((identity, np.mean(corners, axis=0), fit))
        return found, fit

    def found(self, image: NDArray[Any]) -> list[Found]:
        """Tags detected in an image, grey or BGR."""
        self.fits.clear()
        return [
            Found(each.target.id, each.point_px, each.corners_px)
            for each in self.detect_all(image)
            if not isinstance(each.target, TagFamily)
        ]

    def best_fit(self, tag: Found) -> TagFit | None:
        """Best fit of the last image that was an attempt at a tag; None if there was no attempt."""
        reach = _NEAR_EDGES * edge(tag.corners_px)
        tried = [
            fit
            for number, middle, fit in self.fits
            if number == tag.id and np.linalg.norm(middle - tag.centre_px) < reach
        ]
        return max(tried, key=lambda fit: fit.explained_fraction, default=None)


@dataclass(frozen=True)
class Seen:
    """A tag of a photograph, and the detectors that find it."""

    image: str
    tag: Found
    """Detection of the library if it has one, else ours."""
    ours: bool
    library: tuple[bool, ...]
    """True if the library finds it, without and with its sharpening."""
    fit: TagFit | None = None
    """Our best fit, if only the library finds it."""

    @property
    def row(self) -> dict[str, Any]:
        """Row for the JSON file."""
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
                "explained": round(fit.explained_fraction, 3),
                "wrong": fit.reading.wrong_cells,
                "frame": fit.reading.wrong_rim_cells,
                "unclear": round(fit.reading.worst_quarter_unclear, 3),
                "moved_px": round(fit.max_corner_move_px, 2),
                "sigma_px": round(fit.max_sigma_px, 3),
            }
        return row


def seen_in(
    name: str,
    image: NDArray[Any],
    ours: RecordingDetector,
    library: Sequence[Method],
    least_margin: float = 0.0,
) -> list[Seen]:
    """Tags that our detector or the library finds in an image.

    Args:
        name: name of the image.
        image: (height, width) grey levels or (height, width, 3) BGR.
        ours: our detector, of the same family as the library's.
        library: detectors of the library.
        least_margin: least decision margin of tags that only the library finds, grey levels.
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
    """Images of a folder and of each of its subfolders.

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
    """Counts in a row of the table."""
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
    """Parse, detect, print."""
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
