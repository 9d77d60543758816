"""A board in real photographs of a stereo pair, held in the hand: a public set of 29 pairs."""

from pathlib import Path

import numpy as np
import pytest

from vergence.vision import BoardDetection, Tracker, make_detector, parse_target, read_image

SHARED = Path(__file__).resolve().parents[3] / ".." / "shared" / "data" / "stereo_chessboard"
DETECTOR = make_detector(parse_target("checkerboard:9x6:24.23"))

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def found() -> dict[str, BoardDetection | None]:
    """By the name of each image."""
    if not SHARED.is_dir():
        pytest.skip(f"the photographs are not here: {SHARED}")
    paths = sorted(SHARED.glob("*.jpg"))
    return {path.stem: DETECTOR.detect(read_image(path)) for path in paths}


def test_the_board_is_found_in_every_image(found):
    assert len(found) == 58
    assert [name for name, each in found.items() if each is None] == []


def test_corners_come_in_one_order_in_both_eyes(found):
    """Each corner is farther to the right in the left image, and on about the same line.

    In another order half of the corners would be to the left, and lines apart by half the board;
    rows and columns turn as those of a board seen from its front.
    """
    for name, each in found.items():
        grid = each.corners_px.reshape(6, 9, 2)
        along, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
        assert along[0] * down[1] - along[1] * down[0] > 0, name
        right = found[name.replace("left", "right")]
        apart = each.corners_px - right.corners_px
        assert (apart[:, 0] > 0).all() or each is right, name
        assert np.ptp(apart[:, 1]) < 15.0, name


def test_sigmas_are_those_of_a_hand_held_board_in_compressed_images(found):
    """Between the noise of a pixel and what would bend the grid to the eye."""
    said = [float(np.median(each.corners_sigma_px)) for each in found.values()]
    assert 0.02 < np.median(said) < 0.3
    assert max(said) < 1.0


def test_the_tracker_finds_the_board_in_every_image_as_the_detector_does(found):
    tracker = Tracker(DETECTOR)
    for name in sorted(name for name in found if name.startswith("left"))[:12]:
        each = tracker.find(read_image(SHARED / f"{name}.jpg"))
        assert each.corners_px == pytest.approx(found[name].corners_px, abs=0.2), name
