"""The size of tags on a sheet of many, told from photographs alone."""

import cv2
import numpy as np
import pytest

from benchmarks.tag_images.methods import Found
from benchmarks.tag_images.sheets import share_of

SIZE = 1200, 900
TURNED = cv2.Rodrigues(np.array([0.5, -0.3, 0.2]))[0]


def seen(number: int, columns: int, edge: float) -> Found:
    """A tag of edge times the distance of columns, rows 1.1 times as far from each other."""
    row, column = divmod(number, columns)
    corners = edge * np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    corners += column - 2.0, 1.1 * (row - 1.5)
    flat = np.column_stack([corners, np.zeros(4)]) @ TURNED.T + (0.1, -0.2, 6.0)
    rays = flat[:, :2] / flat[:, 2:]
    bent = rays * (1.0 - 0.1 * (rays**2).sum(axis=1, keepdims=True))
    points = 1000.0 * bent + 0.5 * np.array(SIZE)
    return Found(number, points.mean(axis=0), points)


def test_the_share_of_the_edge_comes_out_through_a_tilt_and_a_lens():
    for edge in (0.5, 0.8):
        share = share_of([seen(number, 5, edge) for number in range(20)], 5, SIZE)
        assert share.value == pytest.approx(edge, abs=1e-4)
        assert share.left_px < 0.02
