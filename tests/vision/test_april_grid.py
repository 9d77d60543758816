"""AprilGrid as printed by Kalibr."""

import numpy as np
import pytest

from tests.naming import named
from vergence.errors import ConfigurationError
from vergence.vision import AprilGrid, parse_target

CODES = (0xD5D628584, 0xD97F18B49, 0xDD280910E, 0xE479E9C98, 0xEBCBCA822, 0xF31DAB3AC)
"""The first tags of 36h11, as Kalibr's createTargetPDF.py lists them."""


def kalibrs(columns: int, rows: int, gap: int) -> np.ndarray:
    """The print, a cell for each bit, as that script places it: y upwards from tag 0's corner."""
    pitch = 10 + gap
    upwards = np.full((rows * pitch + gap, columns * pitch + gap), 255, np.uint8)
    for identity in range(columns * rows):
        row, column = divmod(identity, columns)
        x, y = column * pitch + gap, row * pitch + gap
        upwards[y : y + 10, x : x + 10] = 0
        for i in range(6):
            for j in range(6):
                # its matrix of bits begins with the lowest, and is turned by half a turn
                if CODES[identity] >> (6 * (5 - i) + 5 - j) & 1:
                    upwards[y + 2 + 5 - i, x + 2 + j] = 255
        for dx, dy in ((-gap, -gap), (10, -gap), (10, 10), (-gap, 10)):
            upwards[y + dy : y + dy + gap, x + dx : x + dx + gap] = 0
    return upwards[::-1]


def test_the_print_is_kalibrs() -> None:
    grid = AprilGrid(columns=3, rows=2, spacing=0.3)
    gap = 3
    np.testing.assert_array_equal(grid.cells[gap:-gap, gap:-gap], kalibrs(3, 2, gap))


def test_black_and_white_alternate_at_every_corner() -> None:
    for spacing in (0.3, 0.25, 0.2954):
        with named(spacing):
            grid = AprilGrid(columns=3, rows=4, spacing=spacing)
            places = grid.corners_m / grid.cell_m + grid.origin_cells
            x, y = np.rint(places).astype(int).T
            # what is drawn is as near as cells allow
            assert np.abs(places - np.rint(places)).max() * grid.cell_m < 0.005 * grid.tag_m
            cells = grid.cells
            assert (cells[y, x] == cells[y - 1, x - 1]).all()
            assert (cells[y, x - 1] == cells[y - 1, x]).all()
            assert (cells[y, x] != cells[y, x - 1]).all()


def test_tag_0_is_the_lower_left_one_and_corners_go_around_clockwise() -> None:
    grid = AprilGrid(columns=3, rows=2, tag_m=0.1, spacing=0.2)
    corners = grid.corners_m.reshape(-1, 4, 2)
    np.testing.assert_allclose(corners[0].mean(axis=0), [-0.12, 0.06], atol=1e-12)
    np.testing.assert_allclose(corners[5].mean(axis=0), [0.12, -0.06], atol=1e-12)
    steps = np.diff(corners[0], axis=0)
    np.testing.assert_allclose(steps, [[0.1, 0], [0, 0.1], [-0.1, 0]], atol=1e-12)


def test_grids_are_read_from_text() -> None:
    grid = parse_target("aprilgrid:6x7:88:0.3")
    assert grid == AprilGrid(columns=6, rows=7, tag_m=0.088, spacing=0.3)
    assert str(grid) == "aprilgrid:6x7:88:0.3"


def test_grids_that_cannot_be_are_refused() -> None:
    for text, said in (
        ("aprilgrid:6x6:88", "expected aprilgrid:COLUMNSxROWS:TAG:SPACING"),
        ("aprilgrid:6x6:88:0.3:1", "expected aprilgrid:COLUMNSxROWS:TAG:SPACING"),
        ("aprilgrid:0x6:88:0.3", "1 to 587 tags"), ("aprilgrid:30x20:88:0.3", "1 to 587 tags"),
        ("aprilgrid:6x6:88:26.4", "the gap between two tags by the edge of one, between 0 and 1"),
    ):  # fmt: skip
        with named(text), pytest.raises(ConfigurationError, match=said):
            parse_target(text)
