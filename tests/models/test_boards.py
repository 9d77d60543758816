"""What is printed on the boards."""

import cv2
import numpy as np
import pytest

from vergence.errors import ConfigurationError, UnknownNameError
from vergence.models.boards import outline_m, texture
from vergence.vision import AprilTag, Checkerboard, make_planar_target


@pytest.mark.parametrize("identity", [0, 7, 586])
def test_tag_carries_the_bits_of_opencvs_dictionary(identity: int) -> None:
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    cells = AprilTag(id=identity).cells
    code = (cells[2:8, 2:8] > 0).astype(np.uint8)
    found, read, turns = dictionary.identify(code, 0.0)
    assert (found, read, turns) == (True, identity, 0)


def test_tag_has_a_black_border_inside_a_white_quiet_zone() -> None:
    cells = AprilTag().cells
    assert cells.shape == (10, 10)
    ring = np.ones((10, 10), bool)
    ring[1:-1, 1:-1] = False
    border = np.zeros((10, 10), bool)
    border[1:-1, 1:-1] = True
    border[2:-2, 2:-2] = False
    assert (cells[ring] == 255).all()
    assert (cells[border] == 0).all()


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


def test_checkerboard_differs_from_itself_upside_down() -> None:
    cells = Checkerboard().cells
    assert (cells != cells[::-1, ::-1]).any()


def test_inner_corners_lie_where_four_squares_alternate() -> None:
    board = Checkerboard()
    columns, rows = np.rint(board.corners_m / board.cell_m + board.origin_cells).astype(int).T
    cells = board.cells
    assert (cells[rows, columns] == cells[rows - 1, columns - 1]).all()
    assert (cells[rows, columns] != cells[rows - 1, columns]).all()
    assert (cells[rows, columns] != cells[rows, columns - 1]).all()


def test_texture_is_the_cells_enlarged() -> None:
    tag = AprilTag()
    image = texture(tag, 3, surround=90, rim=2)
    assert image.dtype == np.uint8
    assert image.shape == (34, 34)
    assert (image[3:-2:3, 3:-2:3] == tag.cells).all()
    assert (image[:2] == 90).all()


@pytest.mark.parametrize(("columns", "rows"), [(5, 5), (4, 6), (2, 5)])
def test_board_that_cannot_be_told_from_itself_turned_is_refused(columns: int, rows: int) -> None:
    with pytest.raises(ConfigurationError, match="inner corners"):
        Checkerboard(columns=columns, rows=rows)


def test_impossible_tags_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="id"):
        AprilTag(id=587)
    with pytest.raises(ConfigurationError, match="edge_m"):
        AprilTag(edge_m=0.0)


def test_targets_are_found_by_name() -> None:
    assert make_planar_target("tag") == AprilTag()
    assert make_planar_target("checkerboard") == Checkerboard()
    with pytest.raises(UnknownNameError):
        make_planar_target("circle")
