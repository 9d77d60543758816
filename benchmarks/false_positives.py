"""List false detections: targets found in images that contain none.

Run ``python -m benchmarks.false_positives FOLDER --target tag:36h11 tag:36h11:5 checkerboard:9x6``,
with ``--json FILE`` to keep the list. All subfolders are searched. ``--method`` selects another
tag detector by its name in `benchmarks.tag_images.methods`. ``--size 1040x860`` also measures how
long a loop's search for a lost target takes in the images at that size, for each of the search
variants that alternate.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import vergence.vision
from benchmarks.tag_images.methods import METHODS, make_methods
from benchmarks.tag_images.photographs import image_paths, read_image
from vergence.errors import VergenceError

_WAYS = 4
"""Number of search variants of a detector, after which they repeat."""
Find = Callable[[NDArray[np.uint8]], list[dict[str, Any]]]
"""Function from a grey image to its detections: id and position of each."""


def finder(target: str, method: str) -> Find:
    """Detection function for a target.

    Args:
        target: target such as ``tag:36h11:5`` or ``checkerboard:9x6``.
        method: ``vergence``, or, for tags alone, another of `METHODS`.

    Raises:
        VergenceError: the method is not installed, or does not support such targets.
    """
    if method == "vergence":
        return _ours(target)
    kind, family, *number = [*target.split(":"), ""][:4]
    if kind != "tag" or not family:
        raise VergenceError(f"expected a target 'tag:FAMILY' for {method}, got {target!r}")
    lacks: list[str] = []
    methods = make_methods([method], family, lacks.append)
    if not methods:
        raise VergenceError(lacks[0])
    wanted = int(number[0]) if number and number[0] else None

    def find(image: NDArray[np.uint8]) -> list[dict[str, Any]]:
        return [
            _entry(one.id, one.centre_px)
            for one in methods[0].detect(image)
            if wanted in (None, one.id)
        ]

    return find


def _ours(target: str) -> Find:
    vision: Any = vergence.vision
    detector = vision.make_detector(vision.parse_target(target))
    return lambda image: [
        _entry(getattr(seen.target, "id", None), seen.point_px)
        for seen in detector.detect_all(image)
    ]


def _entry(number: int | None, point_px: NDArray[np.float64]) -> dict[str, Any]:
    return {"id": number, "point_px": [round(float(value), 2) for value in point_px]}


def search(find: Find, paths: Sequence[Path]) -> dict[Path, list[dict[str, Any]]]:
    """Detections by image; images without any and images that cannot be read are left out."""
    found = {}
    for count, path in enumerate(paths, 1):
        if count % 100 == 0:
            print(f"{count} of {len(paths)}", file=sys.stderr)
        try:
            image = read_image(path)
        except VergenceError as error:
            print(f"left out: {error}", file=sys.stderr)
            continue
        seen = find(image)
        if seen:
            found[path] = seen
    return found


def search_ms(target: str, paths: Sequence[Path], size: tuple[int, int]) -> NDArray[np.float64]:
    """Time of each search variant in images resized to a size.

    Args:
        target: see `finder`.
        paths: paths of the images.
        size: width and height, px.

    Returns:
        (n, 4) milliseconds of each variant in each image that can be read.
    """
    vision: Any = vergence.vision
    detector = vision.make_detector(vision.parse_target(target))
    taken: list[list[float]] = []
    for path in paths:
        try:
            image = read_image(path)
        except VergenceError:  # reported by `search`
            continue
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
        starts = [time.perf_counter()]
        for way in range(_WAYS):
            detector.search(image, None, way)
            starts.append(time.perf_counter())
        taken.append([1e3 * (b - a) for a, b in pairwise(starts)])
    return np.array(taken).reshape(-1, _WAYS)


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse, search, print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.false_positives")
    parser.add_argument("folder", type=Path, help="images that show none of the targets")
    parser.add_argument("--target", nargs="+", required=True, help="such as tag:36h11")
    parser.add_argument("--method", choices=METHODS, default="vergence")
    parser.add_argument("--json", type=Path, help="file for what is found where")
    parser.add_argument("--size", help="WIDTHxHEIGHT: time a search in images of this size")
    given = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    kept: dict[str, Any] = {}
    try:
        paths = image_paths(given.folder)
        for target in given.target:
            start = time.perf_counter()
            found = search(finder(target, given.method), paths)
            spent_ms = 1e3 * (time.perf_counter() - start) / len(paths)
            number = sum(map(len, found.values()))
            print(
                f"{target}: {number} in {len(found)} of {len(paths)} images, "
                f"{spent_ms:.1f} ms an image with reading it"
            )
            if given.size is not None:
                width, height = map(int, given.size.split("x"))
                for way, spent in enumerate(search_ms(target, paths, (width, height)).T):
                    low, high = np.percentile(spent, [50, 95])
                    print(f"  search by way {way}: median {low:.1f} ms, 95 % {high:.1f} ms")
            listed = {p.relative_to(given.folder).as_posix(): seen for p, seen in found.items()}
            for name, seen in listed.items():
                print(f"  {name}: " + ", ".join(f"{s['id']} at {s['point_px']}" for s in seen))
            kept[target] = {"images": len(paths), "found": listed}
    except VergenceError as error:
        parser.error(str(error))
    if given.json is not None:
        given.json.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
