"""Printed patterns of the boards."""

import numpy as np
import pytest

from tests.naming import named, refused
from vergence.errors import UnknownNameError
from vergence.vision import (
    AprilGrid,
    AprilTag,
    CharucoBoard,
    Checkerboard,
    TagFamily,
    make_planar_target,
    parse_target,
)
from vergence.vision.tag_families import (
    CORRECTED_BITS,
    UNPRINTED,
    library_family,
    load_library,
    tag_family,
)
from vergence.vision.targets import outline_m


def test_tag_is_measured_at_the_centre_of_its_black_square() -> None:
    tag = AprilTag(edge_m=0.16)
    assert tag.corners_m.mean(axis=0) == pytest.approx([0, 0])
    assert outline_m(tag)[0] == pytest.approx([-0.1, -0.1])


def test_checkerboard_is_measured_at_its_upper_right_inner_corner() -> None:
    board = Checkerboard(columns=5, rows=4, square_m=0.03)
    corners = board.corners_m.reshape(4, 5, 2)
    assert corners[0, -1] == pytest.approx([0, 0])
    assert corners[0, 0] == pytest.approx([-0.12, 0])
    assert corners[-1, -1] == pytest.approx([0, 0.09])
    assert outline_m(board)[1] == pytest.approx([0.06, -0.06])


def test_black_and_white_alternate_at_every_inner_corner() -> None:
    grids = (AprilGrid(columns=3, rows=4, spacing=spacing) for spacing in (0.3, 0.25, 0.2954))
    for board in (Checkerboard(), *grids):
        with named(board):
            places = board.corners_m / board.cell_m + board.origin_cells
            x, y = np.rint(places).astype(int).T
            # what is drawn is as near as cells allow
            assert np.abs(places - np.rint(places)).max() * board.cell_m < 5e-4
            cells = board.cells
            assert (cells != cells[::-1, ::-1]).any()
            assert (cells[y, x] == cells[y - 1, x - 1]).all()
            assert (cells[y, x - 1] == cells[y - 1, x]).all()
            assert (cells[y, x] != cells[y, x - 1]).all()


def test_board_that_looks_the_same_turned_is_measured_at_its_middle() -> None:
    for columns, rows in ((5, 5), (4, 6), (10, 10)):
        with named(columns, rows):
            board = Checkerboard(columns=columns, rows=rows)
            assert board.symmetric
            assert (board.cells == board.cells[::-1, ::-1]).all()
            assert board.corners_m.mean(axis=0) == pytest.approx([0.0, 0.0])
            assert outline_m(board).mean(axis=0) == pytest.approx([0.0, 0.0])


def test_board_without_a_rim_ends_with_its_squares() -> None:
    board, rimmed = Checkerboard(white_rim=False), Checkerboard()
    assert (board.cells == rimmed.cells[1:-1, 1:-1]).all()
    assert board.corners_m == pytest.approx(rimmed.corners_m)


def test_tags_are_the_librarys_own() -> None:
    for family in sorted(CORRECTED_BITS):
        with named(family):
            library = load_library()
            library.apriltag_to_image.restype = library.image_u8_create.restype
            code, pointer = tag_family(family), library_family(load_library(), family)
            for identity in (0, 7, len(code.code_words) - 1):
                drawn = library.apriltag_to_image(pointer, identity).contents
                pixels = np.ctypeslib.as_array(drawn.buf, shape=(drawn.height, drawn.stride))
                cells = code.cells(identity)
                printed = cells != UNPRINTED
                assert (cells[printed] == pixels[:, : drawn.width][printed]).all()


def test_charuco_board_is_opencvs() -> None:
    for legacy in (False, True):
        for columns, rows in ((7, 5), (6, 8)):
            with named(legacy, columns, rows):
                board = CharucoBoard(columns=columns, rows=rows, legacy=legacy)
                theirs = np.asarray(board.opencv_board().getChessboardCorners())[:, :2]
                centre = 0.5 * board.square_m * np.array([columns, rows])
                assert board.corners_m == pytest.approx(theirs - centre, abs=1e-7)
                size = board.cells.shape[::-1]
                large = board.opencv_board().generateImage((10 * size[0], 10 * size[1]))
                assert (large[5::10, 5::10] == board.cells).all()


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


def test_aprilgrid_is_kalibrs() -> None:
    grid = AprilGrid(columns=3, rows=2, spacing=0.3)
    gap = 3
    np.testing.assert_array_equal(grid.cells[gap:-gap, gap:-gap], kalibrs(3, 2, gap))


def test_tag_0_is_the_lower_left_one_and_corners_go_around_clockwise() -> None:
    grid = AprilGrid(columns=3, rows=2, tag_m=0.1, spacing=0.2)
    corners = grid.corners_m.reshape(-1, 4, 2)
    np.testing.assert_allclose(corners[0].mean(axis=0), [-0.12, 0.06], atol=1e-12)
    np.testing.assert_allclose(corners[5].mean(axis=0), [0.12, -0.06], atol=1e-12)
    steps = np.diff(corners[0], axis=0)
    np.testing.assert_allclose(steps, [[0.1, 0], [0, 0.1], [-0.1, 0]], atol=1e-12)


def test_targets_are_read_from_text() -> None:
    for text, target in [
        ("tag:36h11:5:120", AprilTag(id=5, edge_m=0.12)), ("tag:tag36h11:5", AprilTag(id=5)),
        ("tag:standard41h12:3:50", AprilTag(family="Standard41h12", id=3, edge_m=0.05)),
        ("tag:36h11", TagFamily()),
        ("checkerboard:9x6:24.23", Checkerboard(columns=9, rows=6, square_m=0.02423)),
        (
            "charuco:5x7:40:30:DICT_5X5_100:legacy",
            CharucoBoard(columns=5, rows=7, dictionary="DICT_5X5_100", legacy=True),
        ),
        ("aprilgrid:6x7:88:0.3", AprilGrid(columns=6, rows=7, tag_m=0.088, spacing=0.3)),
    ]:  # fmt: skip
        with named(text, target):
            assert parse_target(text) == target
            assert parse_target(str(parse_target(text))) == target


def test_texts_that_are_no_target_are_refused() -> None:
    said = "checkerboard, tag, got 'circle'"
    refused(said, make_planar_target, "circle", error=UnknownNameError)
    for text, said in [
        ("tag", "tag:FAMILY"), ("tag:36h12:1", "36h11"), ("tag:36h11:587:120", "0 to 586"),
        ("tag:36h11:5:-3", "edge in mm"), ("checkerboard:9by6", "checkerboard:9x6:24.23"),
        ("checkerboard:9x2:20", "inner corners"), ("checkerboard:5x201:20", "inner corners"),
        ("charuco:7x5:30:40:4X4_50", "less than a square"),
        ("charuco:7x5:40:30:4X4_51", "DICT_4X4_50"), ("charuco:40x40:40:30:4X4_50", "800 markers"),
        ("circles:3x3", "printed board"), ("", "printed board"),
        ("aprilgrid:6x6:88", "expected aprilgrid:COLUMNSxROWS:TAG:SPACING"),
        ("aprilgrid:6x6:88:0.3:1", "expected aprilgrid:COLUMNSxROWS:TAG:SPACING"),
        ("aprilgrid:0x6:88:0.3", "1 to 587 tags"), ("aprilgrid:30x20:88:0.3", "1 to 587 tags"),
        ("aprilgrid:6x6:88:26.4", "the gap between two tags by the edge of one, between 0 and 1"),
    ]:  # fmt: skip
        refused(said, parse_target, text)
