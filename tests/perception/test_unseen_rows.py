"""A board with more rows than the images show, although their place is in view."""

import numpy as np
import pytest

from vergence.perception.notes import PhotographNotes
from vergence.vision import make_detector, parse_target
from vergence.vision.targets import CharucoBoard, texture


def drawn(name):
    target = parse_target(name)
    cells_px = 3 if isinstance(target, CharucoBoard) else 8
    return texture(target, cells_px, rim_px=200, blur_px=0.7)


def notes(asked, images):
    target = parse_target(asked)
    check, detector = PhotographNotes([target]), make_detector(target)
    for image in images:
        check.add(image, [detector.detect(image)], check_white=False)
    return list(check.lines())


@pytest.mark.parametrize(
    ("asked", "there"),
    [
        ("aprilgrid:3x4:40:0.3", "aprilgrid:3x3:40:0.3"),
        ("aprilgrid:3x5:40:0.3", "aprilgrid:3x3:40:0.3"),
        ("charuco:6x6:40:30:4X4_50", "charuco:6x5:40:30:4X4_50"),
        ("charuco:6x5:40:30:4X4_50:legacy", "charuco:6x4:40:30:4X4_50"),
        ("charuco:6x6:40:30:4X4_50:legacy", "charuco:6x4:40:30:4X4_50:legacy"),
    ],
)
def test_the_board_without_the_rows_that_no_image_shows_is_named(asked, there):
    (line,) = notes(asked, [drawn(there)])
    assert line.startswith(f"{asked}: its last row is in 0 of 1 images")
    assert f"the board is {there}," in line
    assert notes(there, [drawn(there)]) == []


@pytest.mark.slow
@pytest.mark.parametrize("asked", ["aprilgrid:3x4:40:0.3", "charuco:6x5:40:30:4X4_50"])
def test_a_row_that_one_image_shows_or_that_is_out_of_view_is_not_missed(asked):
    whole = drawn(asked)
    if asked.startswith("aprilgrid"):  # its last row is the upper one
        whole = np.ascontiguousarray(whole[::-1, ::-1])
    end = 200 + int(0.7 * (len(whole) - 400))
    hidden = whole.copy()
    hidden[end:] = 120
    assert len(notes(asked, [hidden, hidden])) == 1
    assert notes(asked, [hidden, hidden, whole]) == []
    assert notes(asked, [whole[:end]]) == []
