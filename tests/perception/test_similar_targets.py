"""Hints at the cause if a board or a tag is not found."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.naming import named
from vergence.models.camera import Camera
from vergence.models.head_file import load_head
from vergence.perception.finding import parse_targets
from vergence.perception.notes import _reduced, describe_similar_targets
from vergence.vision import make_detector
from vergence.vision.targets import CharucoBoard, texture


def drawn(name):
    (target,) = parse_targets([name])
    cells_px = 3 if isinstance(target, CharucoBoard) else 12
    return texture(target, cells_px, rim_px=20, blur_px=0.7)


def hint(image, asked):
    return describe_similar_targets(image, parse_targets([asked]))


def test_a_large_images_camera_is_reduced_with_it():
    camera = Camera.of(load_head("simulated"), 0)
    wide = replace(camera, size=(4000, 2000))
    image, less = _reduced(np.zeros((2000, 4000), np.uint8), wide)
    scale = image.shape[1] / 4000
    assert (less.width, less.height) == image.shape[::-1]
    assert scale < 1.0
    assert less.focal == pytest.approx([scale * one for one in camera.focal])
    assert less.principal == pytest.approx([scale * (one + 0.5) - 0.5 for one in camera.principal])


@pytest.mark.slow
def test_a_charuco_board_of_other_counts_or_markers_is_named():
    image = drawn("charuco:6x5:40:30:4X4_50")
    for asked in (
        "charuco:5x4:40:30:4X4_50",  # its inner corners
        "charuco:7x5:40:30:4X4_50",
        "charuco:6x5:40:30:6X6_250",
    ):
        with named(asked):
            assert hint(image, asked) == "charuco:6x5:40:30:4X4_50 is there"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shown", "asked", "there"),
    [
        ("6x6", "6x6:L", "6x6"),  # not the taller board of the same numbers
        ("6x6:L", "6x5", "6x6:L"),
        ("5x6", "5x5:L", "5x6"),
        ("5x6:L", "5x5", "5x6:L"),
        ("7x5:L", "9x4:L", "7x5"),
    ],
)
def test_a_named_charuco_board_has_the_layout_that_is_there(shown, asked, there):
    def spelled(name):
        counts, _, legacy = name.partition(":")
        return f"charuco:{counts}:40:30:4X4_50{':legacy' if legacy else ''}"

    image = drawn(spelled(shown))
    assert make_detector(*parse_targets([spelled(asked)])).detect(image) is None
    assert hint(image, spelled(asked)) == f"{spelled(there)} is there"
    assert make_detector(*parse_targets([spelled(there)])).detect(image) is not None


@pytest.mark.slow
def test_markers_that_begin_at_another_id_are_said():
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    board = cv2.aruco.CharucoBoard((6, 5), 0.04, 0.03, dictionary, np.arange(20, 35))
    image = np.asarray(board.generateImage((600, 500), marginSize=20))
    there = "a board of 4X4_50 whose ids begin at 20 in place of 0 is there"
    assert hint(image, "charuco:6x5:40:30:4X4_50") == there


@pytest.mark.parametrize("asked", ["tag:36h11", "charuco:6x5:40:30:4X4_50", "aprilgrid:4x3:40:0.3"])
def test_a_mirrored_image_and_a_negative_are_said(asked):
    image = drawn(asked if asked != "tag:36h11" else "tag:36h11:5")
    assert hint(np.ascontiguousarray(image[:, ::-1]), asked).endswith(" is there, mirrored")
    assert hint(255 - image, asked).endswith(" is there, white on black")
    assert hint(np.full((200, 200), 120, np.uint8), asked) == ""
