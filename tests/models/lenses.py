"""Heads with lenses of every model, that the tests of cameras share."""

from typing import Final

import numpy as np

from vergence.models import HeadModel, load_head

COEFFICIENTS: Final = {
    "brown-conrady": (-0.3, 0.12, 1e-3, -1e-3, -0.02),
    "rational": (0.35, -0.02, 1e-3, -5e-4, 0.003, 0.75, 0.06, -0.0004),
    "fisheye": (-0.02, 0.004, -0.003, 0.0006),
}
"""Strong but real ones: rays up to 59, 76 and 90 degrees from the axis are in the image."""
FOCAL: Final = {"brown-conrady": 430.0, "rational": 230.0, "fisheye": 310.0}
LENSES: Final = tuple(COEFFICIENTS)


def wide(left: str, right: str | None = None) -> HeadModel:
    """The physical head with lenses of given models, and images of 800 x 600 and 640 x 480."""
    lens = (left, left if right is None else right)
    distortion = np.zeros((2, 8))
    for eye, name in enumerate(lens):
        distortion[eye, : len(COEFFICIENTS[name])] = COEFFICIENTS[name]
    focal = np.array([[FOCAL[lens[0]]], [0.8 * FOCAL[lens[1]]]]) * [1.0, 1.004]
    return load_head("physical").replace(
        cameras={
            "size": [[800, 600], [640, 480]], "focal": focal,
            "principal": [[402.5, 296.0], [318.0, 243.0]], "distortion": distortion, "lens": lens,
        }
    )  # fmt: skip
