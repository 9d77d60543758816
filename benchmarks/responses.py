"""Compare sRGB and linear camera response by the edges of targets in photographs.

Run ``python -m benchmarks.responses FOLDER --target tag:36h11``. Each subfolder of the folder
(or the folder itself, if it has none) is a row, split into images with and without colours. The
value is the mean over edges of log(S_linear / S_srgb), where S is the sum of squared residuals of
the grey levels of an edge under a response; above 0, sRGB fits better.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from vergence.errors import VergenceError
from vergence.perception.notes import srgb_fit_log_ratios
from vergence.perception.photographs import SUFFIXES
from vergence.vision import make_detector, parse_target
from vergence.vision.image import (
    grey_if_channels_equal,
    has_colour_channels,
    measurement_channel,
    read_pixels,
)

_LARGEST_PX = 2600
"""Largest width or height of a photograph, px; larger ones are left out to save time."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--target", default="tag:36h11")
    parser.add_argument("--most", type=int, default=6, help="images of each folder")
    given = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    detector = make_detector(parse_target(given.target))
    print("| folder | images | edges | mean | standard error | images for sRGB |")
    print("| --- | ---: | ---: | ---: | ---: | ---: |")
    folders = sorted(path for path in given.folder.iterdir() if path.is_dir())
    for folder in folders or [given.folder]:
        files = sorted(p for p in folder.rglob("*") if p.suffix.lower() in SUFFIXES)
        found: dict[bool, list[list[float]]] = {True: [], False: []}
        for path in files[:: max(len(files) // given.most, 1)][: given.most]:
            try:
                image = read_pixels(path)
                if max(image.shape) > _LARGEST_PX:
                    continue
                seen = detector.detect_all(image)
            except VergenceError:
                continue
            ratios = srgb_fit_log_ratios(measurement_channel(image), seen)
            found[has_colour_channels(grey_if_channels_equal(image))].append(ratios)
        for colour, images in found.items():
            every = np.array([ratio for ratios in images for ratio in ratios])
            if len(every) > 1:
                means = [np.mean(ratios) for ratios in images if ratios]
                error = np.std(every, ddof=1) / np.sqrt(len(every))
                print(
                    f"| {folder.name}, {'colour' if colour else 'grey'} | {len(images)} "
                    f"| {len(every)} | {every.mean():.3f} | {error:.3f} "
                    f"| {sum(mean > 0.0 for mean in means)} of {len(means)} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
