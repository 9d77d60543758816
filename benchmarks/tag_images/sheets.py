"""Measure tag sizes relative to their spacing in photographs of one sheet of many tags.

Run ``python -m benchmarks.tag_images.sheets FOLDER --columns 24``: all photographs in the folder
show the same sheet, on which number n stands in row n // 24. The ratio of a tag's edge to the
distance between neighbours' centres is the same in all of them. If edges are found displaced by
some pixels, by sharpening, tone curves or ink, the ratio depends on the size of the tags in the
image, since centres hardly move. So near photographs give the reference for far ones, and neither
sheet nor camera need be known.

A homography, two coefficients of radial distortion about the image's centre, the distance of rows
and the ratio are fitted to all corners, once to ours and once to those of the AprilTag library. A
sheet that is not flat shows in the residuals.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from benchmarks.tag_images.methods import Found, make_methods
from benchmarks.tag_images.photographs import edge, image_paths
from benchmarks.tag_images.rates import RecordingDetector
from benchmarks.tag_images.scores import ordered_as
from vergence.errors import VergenceError
from vergence.vision import as_grey, parse_target
from vergence.vision.image import read_pixels

_SQUARE = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
_LEAST_TAGS = 3


class Share(NamedTuple):
    """Ratio of a tag's edge to the distance between the centres of neighbours in a row."""

    value: float
    sigma: float
    left_px: float
    """Root mean square residual of the corners, px."""


def share_of(tags: Sequence[Found], columns: int, size: tuple[int, int]) -> Share:
    """Ratio fitted to the tags of an image.

    Args:
        tags: at least three tags with distinct numbers.
        columns: tags in a row of the sheet.
        size: width and height of the image, px.
    """
    places = np.array([divmod(tag.id, columns)[::-1] for tag in tags], float)
    places -= places.mean(axis=0)
    scale = float(max(size))
    seen = (np.vstack([tag.corners_px for tag in tags]) - 0.5 * np.array(size)) / scale

    def on_sheet(share: float, row: float) -> NDArray[np.float64]:
        return ((places * (1.0, row))[:, None] + share * _SQUARE).reshape(-1, 2)

    def left_px(x: NDArray[np.float64]) -> NDArray[np.float64]:
        flat = np.column_stack([on_sheet(x[0], x[1]), np.ones(len(seen))])
        bent = flat @ np.append(x[4:], 1.0).reshape(3, 3).T
        bent = bent[:, :2] / bent[:, 2:]
        square = (bent**2).sum(axis=1, keepdims=True)
        bent *= 1.0 + x[2] * square + x[3] * square**2
        return np.asarray((bent - seen).ravel() * scale)

    start, _ = cv2.findHomography(on_sheet(0.8, 1.0), seen)
    first = np.concatenate([[0.8, 1.0, 0.0, 0.0], (start / start[2, 2]).ravel()[:8]])
    found = least_squares(left_px, first, x_scale="jac", loss="soft_l1")
    variance = float((found.fun**2).mean())
    sigma = float(np.sqrt(variance * np.linalg.pinv(found.jac.T @ found.jac)[0, 0]))
    return Share(float(found.x[0]), sigma, float(np.sqrt(variance)))


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse, detect, print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.tag_images.sheets")
    parser.add_argument("folder", type=Path, help="photographs of one sheet")
    parser.add_argument("--columns", type=int, required=True, help="tags in a row")
    parser.add_argument("--family", default="36h11", help="(default: 36h11)")
    given = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    rows = []
    try:
        ours = RecordingDetector(parse_target(f"tag:{given.family}"))
        library = make_methods(["pyapriltags"], given.family, parser.error)[0]
        for path in image_paths(given.folder):
            print(path, file=sys.stderr, flush=True)
            image = read_pixels(path)
            tags = {tag.id: tag for tag in ours.found(image)}
            others = {
                tag.id: replace(tag, corners_px=ordered_as(tag.corners_px, tags[tag.id].corners_px))
                for tag in library.detect(as_grey(image))
                if tag.id in tags
            }
            both = sorted(others)
            if len(both) < _LEAST_TAGS:
                continue
            size = image.shape[1], image.shape[0]
            edge_px = float(np.median([edge(tags[each].corners_px) for each in both]))
            shares = [
                share_of([each[number] for number in both], given.columns, size)
                for each in (tags, others)
            ]
            cells = (f"{s.value:.4f} ± {s.sigma:.4f} ({s.left_px:.2f} px)" for s in shares)
            rows.append((edge_px, f"| {path.name} | {len(both)} | {edge_px:.0f} | ", *cells))
    except VergenceError as error:
        parser.error(str(error))
    print("| image | tags | edge, px | vergence | library |")
    print("|---|---:|---:|---:|---:|")
    for _, name, first, second in sorted(rows):
        print(f"{name}{first} | {second} |")


if __name__ == "__main__":
    main()
