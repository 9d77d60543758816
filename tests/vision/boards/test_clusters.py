"""Clusters of corners that may be a checkerboard, and none in images without a board."""

import cv2
import numpy as np
import pytest

from tests.grids import some_of
from tests.naming import named
from tests.vision.boards.test_checkerboards import board, drawn
from tests.vision.scenes import Image, defocus, rig
from vergence.vision import make_detector
from vergence.vision.checkerboards import find_corner_clusters

SIZES = [(3, 3), (5, 4), (9, 6), (12, 9)]


def blocks(cell_px: int, shape: tuple[int, int], seed: int = 0) -> Image:
    """Black and white squares by chance: corners everywhere, and no board."""
    rng = np.random.default_rng(seed)
    cells = rng.integers(0, 2, (shape[0] // cell_px + 1, shape[1] // cell_px + 1))
    large = np.kron(cells, np.ones((cell_px, cell_px), int))[: shape[0], : shape[1]]
    return (40 + 180 * large).astype(np.uint8)


def tiles(cell_px: int, shape: tuple[int, int]) -> Image:
    rows, columns = np.arange(shape[0]) // cell_px, np.arange(shape[1]) // cell_px
    return (40 + 180 * (np.add.outer(rows, columns) % 2)).astype(np.uint8)


def text(shape: tuple[int, int]) -> Image:
    image = np.full(shape, 235, np.uint8)
    for line in range(20, shape[0], 16):
        words = "the quick brown fox jumps over 13 lazy dogs 0123456789 # @"
        cv2.putText(image, words, (5, line), cv2.FONT_HERSHEY_SIMPLEX, 0.5, 20, 1, cv2.LINE_AA)
    return image


def test_the_corners_of_a_board_are_one_cluster():
    for square_px, (columns, rows) in [
        *((9.0, size) for size in SIZES), (20.0, (5, 4)), (30.0, (12, 9)), (40.0, (3, 3)),
    ]:  # fmt: skip
        with named(square_px, columns, rows):
            one = drawn(board(columns, rows, square_px), 0.2, (0.0, 0.3))
            ((region, corners),) = find_corner_clusters(one.image, columns * rows)
            assert len(corners) == columns * rows
            away = np.linalg.norm(corners[:, None] - one.corners, axis=-1)
            assert away.min(axis=0).max() < 1.5
            assert away.min(axis=1).max() < 1.5
            x0, y0, x1, y1 = region
            # the outermost squares lie in it too
            assert (one.corners > np.array([x0, y0]) + square_px).all() or min(x0, y0) == 0
            assert (one.corners < np.array([x1, y1]) - square_px).all()


NO_BOARDS = {
    "grey": np.full((480, 640), 120, np.uint8),
    "ramp": np.tile(np.linspace(0, 255, 640).astype(np.uint8), (480, 1)),
    "waves": (127 + 100 * np.sin(np.arange(640) / 3.0) * np.ones((480, 1))).astype(np.uint8),
    "noise": np.random.default_rng(3).normal(120, 3, (480, 640)).clip(0, 255).astype(np.uint8),
    "text": text((480, 640)),
    "tiles": tiles(12, (480, 640)),  # of 2,000 corners: no board of 54
}


def test_what_is_no_board_has_no_cluster():
    for corners, kind in some_of([9, 54], list(NO_BOARDS)):
        with named(corners, kind):
            assert find_corner_clusters(NO_BOARDS[kind], corners) == []


def test_blocks_that_lie_by_chance_have_few_clusters_and_small_ones():
    image = blocks(12, (860, 1040))
    for (x0, y0, x1, y1), _corners in find_corner_clusters(image, 54):
        assert (x1 - x0) * (y1 - y0) < 0.5 * image.size


@pytest.mark.parametrize("way", [None, 0])
def test_a_board_among_blocks_is_found(way):
    target = board(9, 6)
    one = drawn(target, 0.2, (0.0, 0.3))
    image, room = blocks(10, one.image.shape, seed=4), 70
    x0, y0 = np.floor(one.corners.min(axis=0) - room).astype(int).clip(0)
    x1, y1 = np.ceil(one.corners.max(axis=0) + room).astype(int)
    image[y0:y1, x0:x1] = one.image[y0:y1, x0:x1]
    found = make_detector(target, rig("simulated")[0]).search(image, None, way)
    assert found.corners_px == pytest.approx(one.corners, abs=0.2)


@pytest.mark.slow
def test_small_squares_are_found_in_the_turn_that_looks_at_the_whole_image():
    target = board(9, 6, 11.0)
    one, detector = drawn(target, 0.2, (0.0, 0.3)), make_detector(target)
    wide = cv2.copyMakeBorder(one.image, 0, 900, 0, 1160, cv2.BORDER_REPLICATE)
    assert detector.search(wide, None, 0) is None
    for way in (None, 1):
        found = detector.search(wide, None, way)
        assert found.corners_px == pytest.approx(one.corners, abs=0.2)


@pytest.mark.parametrize("way", [None, 3])
def test_a_board_out_of_focus_is_found_in_a_small_image(way):
    target = board(4, 3, 80.0)
    one = drawn(target, 0.2, (0.0, 0.3))
    blurred = defocus(9.0)(one.image, one.point)
    found = make_detector(target, rig("simulated")[0]).search(blurred, None, way)
    assert np.abs(found.corners_px - one.corners).max() < 1.0
