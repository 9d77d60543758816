"""Images that show no target: nothing is found in them."""

import cv2
import numpy as np
import pytest

from tests.naming import named
from vergence.vision import AprilGrid, CharucoBoard, Checkerboard, TagFamily, make_detector

SIZE = (120, 160)
TAGS = ("36h11", "36h10", "25h9", "16h5", "Standard41h12", "Circle21h7")
TARGETS = {
    **{family: TagFamily(family=family) for family in TAGS},
    "5x4": Checkerboard(columns=5, rows=4),
    "3x3": Checkerboard(columns=3, rows=3),
    "charuco": CharucoBoard(columns=5, rows=4),
    "aprilgrid": AprilGrid(columns=2, rows=2),
}


def noise(rng: np.random.Generator) -> np.ndarray:
    """Small: OpenCV finds hundreds of squares in it, and compares each with all tags."""
    return rng.integers(0, 256, (60, 80), np.uint8)


def blobs(rng: np.random.Generator, sigma: float) -> np.ndarray:
    """Noise of one size, stretched over all levels."""
    smooth = cv2.GaussianBlur(rng.normal(size=SIZE), (0, 0), sigma)
    return cv2.normalize(smooth, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)


def boxes(rng: np.random.Generator) -> np.ndarray:
    """Turned rectangles upon each other: windows, books, boxes."""
    image = np.full(SIZE, 128, np.uint8)
    for _ in range(25):
        middle, sides = tuple(rng.uniform(0, SIZE[::-1])), tuple(rng.uniform(8, 60, 2))
        turn = rng.uniform(0, 90) * rng.integers(0, 2)
        corners = cv2.boxPoints((middle, sides, turn)).astype(np.int32)
        cv2.fillConvexPoly(image, corners, int(rng.integers(0, 256)))
    return image


def tiles(rng: np.random.Generator, cell: int) -> np.ndarray:
    """Squares of black and white at random."""
    cells = rng.integers(0, 2, (SIZE[0] // cell + 1, SIZE[1] // cell + 1), np.uint8) * 255
    return cells.repeat(cell, 0).repeat(cell, 1)[: SIZE[0], : SIZE[1]]


def grating(period: float, angle: float) -> np.ndarray:
    v, u = np.indices(SIZE)
    phase = 2 * np.pi * (u * np.cos(angle) + v * np.sin(angle)) / period
    return (127.5 + 127.5 * np.sign(np.sin(phase))).astype(np.uint8)


def images() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    out = {"black": np.zeros(SIZE, np.uint8), "white": np.full(SIZE, 255, np.uint8)}
    for k in range(2):
        out[f"noise {k}"] = noise(rng)
        out[f"blobs {k}"] = blobs(rng, 1.5 + 2.5 * k)
        out[f"boxes {k}"] = boxes(rng)
        out[f"tiles {k}"] = tiles(rng, 6 + 8 * k)
        out[f"grating {k}"] = grating(8.0 + 16 * k, 0.8 * k)
        out[f"letters {k}"] = letters(rng)
    return out


def letters(rng: np.random.Generator) -> np.ndarray:
    """A page of text."""
    image = np.full(SIZE, 240, np.uint8)
    for line in range(4):
        text = "".join(chr(c) for c in rng.integers(33, 127, 16))
        cv2.putText(image, text, (5, 18 + 20 * line), cv2.FONT_HERSHEY_SIMPLEX, 0.5, 20, 1)
    return image


IMAGES = images()


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.slow) if name == "5x4" else name for name in TARGETS],
)
def test_nothing_is_found_where_nothing_is(name):
    """In a third of the images of each kind, and in all for the tag that is the default."""
    detector, place = make_detector(TARGETS[name]), list(TARGETS).index(name)
    for k, (kind, image) in enumerate(IMAGES.items()):
        if name == "36h11" or (k + (k - 2) // 6 + place) % 3 == 0:
            with named(kind):
                assert detector.detect_all(image) == []


def floor_of_tiles(square: int) -> np.ndarray:
    v, u = np.indices(SIZE)
    return ((u // square + v // square) % 2 * 170 + 40).astype(np.uint8)


def test_a_checkerboard_is_no_tag():
    for family, square in [("36h11", 8), ("25h9", 13), ("16h5", 30), ("Circle21h7", 13)]:
        with named(family, square):
            detector = make_detector(TagFamily(family=family))
            assert detector.detect_all(floor_of_tiles(square)) == []


@pytest.mark.slow
@pytest.mark.parametrize(("name", "square"), [("5x4", 13), ("3x3", 30)])
def test_a_floor_of_tiles_that_fills_the_image_is_no_board(name, square):
    assert make_detector(TARGETS[name]).detect_all(floor_of_tiles(square)) == []
