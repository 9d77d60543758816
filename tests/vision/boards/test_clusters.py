"""Clusters of corners that may be a checkerboard, and none in images without a board."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.grids import some_of
from tests.vision.poses import pose
from tests.vision.scenes import Image, Scene, defocus, jpeg, rig, scene
from vergence.vision import Checkerboard, make_detector
from vergence.vision.boards.clusters import find_corner_clusters

SIZES = [(3, 3), (5, 4), (9, 6), (12, 9)]


def board(columns: int, rows: int, square_px: float = 20.0) -> Checkerboard:
    """At 1 m before the simulated rig."""
    return Checkerboard(columns=columns, rows=rows, square_m=0.0323 * square_px / 20.0)


def drawn(target: Checkerboard, roll: float = 0.2, turn: float = 0.3) -> Scene:
    camera, rendering = rig("simulated")
    middle = target.corners_m.mean(axis=0)
    T_C_T = pose(0.01, -0.02, 1.0, (0.0, turn, roll)) @ pose(-middle[0], -middle[1], 0)
    return scene(camera, target, T_C_T, rendering, np.random.default_rng(1))


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


@pytest.mark.parametrize(
    ("square_px", "columns", "rows"),
    [(square_px, *size) for square_px, size in some_of([9.0, 20.0, 40.0], SIZES)],
)
def test_the_corners_of_a_board_are_one_cluster(columns, rows, square_px):
    if columns * square_px > 400:
        square_px = 30.0
    one = drawn(board(columns, rows, square_px))
    (found,) = find_corner_clusters(one.image, columns * rows)
    assert len(found.corners_px) == columns * rows
    away = np.linalg.norm(found.corners_px[:, None] - one.corners, axis=-1)
    assert away.min(axis=0).max() < 1.5
    assert away.min(axis=1).max() < 1.5
    x0, y0, x1, y1 = found.region
    # the outermost squares lie in it too
    assert ((one.corners > np.array([x0, y0]) + square_px).all(axis=None)) or min(x0, y0) == 0
    assert (one.corners < np.array([x1, y1]) - square_px).all()


@pytest.mark.parametrize(
    ("corners", "image"),
    some_of(
        [9, 54],
        [
            np.full((480, 640), 120, np.uint8),
            np.tile(np.linspace(0, 255, 640).astype(np.uint8), (480, 1)),
            (127 + 100 * np.sin(np.arange(640) / 3.0) * np.ones((480, 1))).astype(np.uint8),
            np.clip(np.random.default_rng(3).normal(120, 3, (480, 640)), 0, 255).astype(np.uint8),
            text((480, 640)),
            tiles(12, (480, 640)),  # of 2,000 corners: no board of 54
        ],
    ),
)
def test_what_is_no_board_has_no_cluster(image, corners):
    assert find_corner_clusters(image, corners) == []


def test_blocks_that_lie_by_chance_have_few_clusters_and_small_ones():
    image = blocks(12, (860, 1040))
    for found in find_corner_clusters(image, 54):
        x0, y0, x1, y1 = found.region
        assert (x1 - x0) * (y1 - y0) < 0.5 * image.size


@pytest.mark.parametrize("way", [None, 0])
def test_a_board_among_blocks_is_found(way):
    target = board(9, 6)
    one = drawn(target)
    image, room = blocks(10, one.image.shape, seed=4), 70
    x0, y0 = np.floor(one.corners.min(axis=0) - room).astype(int).clip(0)
    x1, y1 = np.ceil(one.corners.max(axis=0) + room).astype(int)
    image[y0:y1, x0:x1] = one.image[y0:y1, x0:x1]
    found = make_detector(target, rig("simulated")[0]).search(image, None, way)
    assert found is not None
    assert found.corners_px == pytest.approx(one.corners, abs=0.2)


def test_small_squares_are_found_in_the_turn_that_looks_at_the_whole_image():
    target = board(9, 6, 11.0)
    one, detector = drawn(target), make_detector(target)
    wide = cv2.copyMakeBorder(one.image, 0, 900, 0, 1160, cv2.BORDER_REPLICATE)
    assert detector.search(wide, None, 0) is None
    for way in (None, 1):
        found = detector.search(wide, None, way)
        assert found.corners_px == pytest.approx(one.corners, abs=0.2)


@pytest.mark.parametrize("way", [None, 3])
def test_a_board_out_of_focus_is_found_in_a_small_image(way):
    target = board(4, 3, 80.0)
    one = drawn(target)
    blurred = defocus(9.0)(one.image, one.point)
    found = make_detector(target, rig("simulated")[0]).search(blurred, None, way)
    assert found is not None
    assert np.abs(found.corners_px - one.corners).max() < 1.0


@pytest.mark.parametrize("surround", [45.0, 205.0])
def test_corners_that_run_together_are_put_back(surround):
    """Before a wall of the grey of its squares, two of OpenCV's corners lie half a square off."""
    camera, rendering = rig("simulated")
    target = Checkerboard(columns=9, rows=6, square_m=0.0323, white_rim=False)
    middle = target.corners_m.mean(axis=0)
    for roll in (0.0, 0.5):
        T_C_T = (
            pose(0.013, -0.021, 1.0)
            @ pose(0, 0, 0, (0, 0, roll))
            @ pose(0, 0, 0, (0.1, 0.2, 0))
            @ pose(-middle[0], -middle[1], 0)
        )
        wall = replace(rendering, background_grey=surround)
        one = scene(camera, target, T_C_T, wall, np.random.default_rng(1))
        found = make_detector(target, camera).search(one.image)
        assert np.abs(found.corners_px - one.corners).max() < 0.1


def test_a_compressed_image_is_searched_as_well():
    target = board(9, 6)
    one = drawn(target)
    image = jpeg(30)(one.image, one.point)
    found = make_detector(target, rig("simulated")[0]).search(image, None, 0)
    assert found is not None
    assert np.abs(found.corners_px - one.corners).max() < 0.5
