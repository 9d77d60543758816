"""Corners that `detect_board_corners` finds in photographs: the camera response at edges."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.vision.poses import pose
from tests.vision.scenes import rig, scene
from vergence.calibration.observations import detect_board_corners
from vergence.vision import AprilTag, Checkerboard, make_detector

TAG = AprilTag(id=5, edge_m=0.12)


@pytest.fixture
def photographs(tmp_path: Path) -> list[list[Path]]:
    """A tag in colours as the left camera sees it, in grey as the right one does."""
    camera, rendering = rig("physical")
    image = scene(camera, TAG, pose(0.02, 0.01, 0.7), rendering).image
    left, right = tmp_path / "left.png", tmp_path / "right.png"
    cv2.imwrite(str(left), cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    cv2.imwrite(str(right), image)
    return [[left], [right]]


def test_photographs_with_colours_are_measured_by_srgb_and_grey_ones_as_they_are(photographs):
    seen, _ = detect_board_corners(TAG, photographs)
    stated, _ = detect_board_corners(TAG, photographs, responses=("srgb", "linear"))
    np.testing.assert_array_equal(seen.pixels, stated.pixels)
    assert not np.array_equal(seen.pixels[0], seen.pixels[1])


@pytest.mark.slow
def test_corners_of_a_soft_image_that_was_halved_are_in_its_own_pixels(tmp_path: Path):
    board = Checkerboard(columns=5, rows=4, square_m=0.03)
    camera, rendering = rig("physical")
    sharp = scene(camera, board, pose(0.02, 0.01, 0.7), rendering).image
    corners = make_detector(board, camera).detect(sharp).corners_px
    soft = cv2.GaussianBlur(cv2.resize(sharp, None, fx=4, fy=4), (0, 0), 24)
    assert make_detector(board).detect(soft) is None
    cv2.imwrite(str(tmp_path / "soft.png"), soft)
    seen, _ = detect_board_corners(board, [[tmp_path / "soft.png"]])
    off = seen.pixels[0, 0] - (4.0 * (corners + 0.5) - 0.5)
    assert np.abs(off.mean(axis=0)).max() < 0.25  # a centre that moves by halving moves 0.5 px
