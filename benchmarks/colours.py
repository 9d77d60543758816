"""Measure where a colour is found in photographs, against OpenCV's own calls.

Run ``python -m benchmarks.colours FOLDER`` on a folder of images, each with one kind of things and
their boxes in an XML file of its name, as in Pascal VOC. A kind's colour is the median within its
boxes. OpenCV's blob is the largest part of ``cv2.inRange`` around this colour. Reported is how
often the first detection lies within 0.15 of the blob's width from the blob's centroid.
"""

import argparse
from collections import defaultdict
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np

from vergence.vision import Camera
from vergence.vision.objects.colours import ColourDetector
from vergence.vision.objects.targets import ColourTarget

SUFFIXES = (".jpg", ".jpeg", ".png")
SIDES = ("xmin", "ymin", "xmax", "ymax")
INNER = np.array([[3, 0, 1, 0], [0, 3, 0, 1], [1, 0, 3, 0], [0, 1, 0, 3]]) / 4.0
"""Takes boxes to their inner halves."""
LONGEST_PX = 640
NEAR = 0.15
HUE, LEAST_SATURATION, LEAST_VALUE = 10, 90, 60


def photographs(folder: Path) -> dict[str, list[tuple[Any, Any]]]:
    """Images of at most 640 pixels, and boxes (n, 4), of each kind."""
    kinds = defaultdict(list)
    for path in sorted(each for each in folder.iterdir() if each.suffix.lower() in SUFFIXES):
        if not path.with_suffix(".xml").is_file():
            continue
        things = list(ElementTree.parse(path.with_suffix(".xml")).iter("object"))
        names = {thing.findtext("name", "") for thing in things}
        image: Any = cv2.imread(str(path))
        if len(names) == 1 and image is not None:
            scale = min(LONGEST_PX / max(image.shape[:2]), 1.0)
            image = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
            boxes = [[float(thing.findtext(f"bndbox/{s}", "0")) for s in SIDES] for thing in things]
            kinds[names.pop()].append((image, scale * np.array(boxes)))
    return kinds


def median_hsv(found: list[tuple[Any, Any]]) -> Any:
    """Median hue, saturation and value within the inner halves of boxes."""
    pixels = []
    for image, boxes in found:
        for x0, y0, x1, y1 in (boxes @ INNER).astype(int).tolist():
            inner: Any = cv2.cvtColor(image, cv2.COLOR_BGR2HSV)[y0 : y1 + 1, x0 : x1 + 1]
            pixels.append(inner.reshape(-1, 3)[:: inner.size // 1500 + 1])
    hue, saturation, value = np.concatenate(pixels).astype(float).T
    turn = np.exp(1j * np.pi / 90.0 * hue)  # red is on both sides of 0
    off = np.median(np.angle(turn / turn.mean()))
    hue = np.rint((np.angle(turn.mean()) + off) * 90.0 / np.pi) % 180
    return np.array([hue, np.median(saturation), np.median(value)], np.uint8)


def opencv_blob(image: Any, hue: int) -> tuple[Any, float]:
    """Centroid and width of the largest part of a hue; a width of 0 if there is none."""
    hsv = cv2.cvtColor(image, cv2.COLOR_BGR2HSV)
    mask: Any = np.zeros(hsv.shape[:2], np.uint8)
    for turn in (hue - 180, hue, hue + 180):
        low = (turn - HUE, LEAST_SATURATION, LEAST_VALUE)
        mask |= cv2.inRange(hsv, low, (turn + HUE, 255, 255))
    mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    _count, _labels, stats, centres = cv2.connectedComponentsWithStats(mask)
    areas = stats[1:, cv2.CC_STAT_AREA]
    if not len(areas):
        return np.zeros(2), 0.0
    return centres[1 + np.argmax(areas)], float(np.sqrt(4.0 / np.pi * areas.max()))


def main() -> None:
    """Print a line for each kind."""
    parser = argparse.ArgumentParser(prog="benchmarks.colours", description=__doc__)
    parser.add_argument("folder", type=Path)
    for kind, found in photographs(parser.parse_args().folder).items():
        hsv = median_hsv(found)
        rgb = cv2.cvtColor(hsv[None, None], cv2.COLOR_HSV2RGB)[0, 0].tolist()
        alike: dict[bool, list[bool]] = {True: [], False: []}
        for image, boxes in found:
            height, width = image.shape[:2]
            matrix = np.array([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1]])
            camera = Camera(size=(width, height), matrix=matrix)
            centre, size = opencv_blob(image, int(hsv[0]))
            if size > 0.0:
                best = ColourDetector(ColourTarget(rgb=tuple(rgb)), camera).detect(image)[:1]
                off = [float(np.linalg.norm(one.pixel - centre)) for one in best]
                alike[len(boxes) == 1].append(bool(off) and off[0] < NEAR * size)
        single, every = alike[True], alike[True] + alike[False]
        print(
            f"{kind} (#{bytes(rgb).hex()}): where OpenCV finds it {sum(every)} of "
            f"{len(every)}; single things {sum(single)} of {len(single)}"
        )


if __name__ == "__main__":
    main()
