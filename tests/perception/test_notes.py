"""Notes on photographs: other targets than those asked for, rows that none shows, wrong light."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.naming import named
from tests.perception.drawn import Studio, pose_at
from tests.vision.poses import pose
from tests.vision.scenes import levels, rig, scene
from vergence.models.camera import Camera, light_table
from vergence.models.head_file import load_head
from vergence.perception.finding import TargetFinder, parse_targets
from vergence.perception.notes import (
    LinearResponseCheck,
    PhotographNotes,
    _reduced,
    describe_similar_targets,
)
from vergence.vision import AprilGrid, make_detector, make_planar_target
from vergence.vision.targets import AprilTag, CharucoBoard, TagFamily, texture


def drawn(name, rim_px=20):
    (target,) = parse_targets([name])
    cells_px = 3 if isinstance(target, CharucoBoard) else 12
    return texture(target, cells_px, rim_px=rim_px, blur_px=0.7)


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
def test_a_charuco_board_of_other_counts_is_named_with_the_layout_that_is_there():
    def spelled(name):
        counts, _, legacy = name.partition(":")
        return f"charuco:{counts}:40:30:4X4_50{':legacy' if legacy else ''}"

    for cases in [
        ("6x5", "5x4", "6x5"),  # its inner corners
        ("6x6", "6x6:L", "6x6"),  # not the taller board of the same numbers
        ("5x6:L", "5x5", "5x6:L"),
        ("7x5:L", "9x4:L", "7x5"),
    ]:
        shown, asked, there = map(spelled, cases)
        image = drawn(shown)
        with named(*cases):
            assert make_detector(*parse_targets([asked])).detect(image) is None
            assert hint(image, asked) == f"{there} is there"
            assert make_detector(*parse_targets([there])).detect(image) is not None


@pytest.mark.slow
def test_other_markers_and_markers_that_begin_at_another_id_are_said():
    there = "charuco:6x5:40:30:4X4_50"
    assert hint(drawn(there), "charuco:6x5:40:30:6X6_250") == f"{there} is there"
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    board = cv2.aruco.CharucoBoard((6, 5), 0.04, 0.03, dictionary, np.arange(20, 35))
    image = np.asarray(board.generateImage((600, 500), marginSize=20))
    assert hint(image, there) == "a board of 4X4_50 whose ids begin at 20 in place of 0 is there"


@pytest.mark.parametrize("asked", ["tag:36h11", "charuco:6x5:40:30:4X4_50", "aprilgrid:4x3:40:0.3"])
def test_a_mirrored_image_and_a_negative_are_said(asked):
    image = drawn(asked if asked != "tag:36h11" else "tag:36h11:5")
    assert hint(np.ascontiguousarray(image[:, ::-1]), asked).endswith(" is there, mirrored")
    assert hint(255 - image, asked).endswith(" is there, white on black")
    assert hint(np.full((200, 200), 120, np.uint8), asked) == ""


@pytest.mark.slow
def test_what_is_there_in_place_of_a_grid_is_said():
    rng, head = np.random.default_rng(0), load_head("simulated")
    asked_grid = AprilGrid(columns=5, rows=4, tag_m=0.03)
    grid = Studio(head, asked_grid).take(pose_at([0.0, -0.02, 0.4]), rng)[0][230:570, 330:710]
    tag = Studio(head, AprilTag(id=7)).take(pose_at([0.0, 0.0, 0.5]), rng)[0]
    there = "aprilgrid:5x4:30:0.3 (tags, and their gap by their edge) is there"
    for asked in ("aprilgrid:4x5:30:0.3", "aprilgrid:5x4:30:0.2"):
        assert describe_similar_targets(grid, parse_targets([asked])) == there
    assert describe_similar_targets(grid, parse_targets(["aprilgrid:5x4:30:0.295"])) == ""
    assert describe_similar_targets(grid, [TagFamily()]).startswith("aprilgrid:5x4:TAG:0.3")
    assert (
        describe_similar_targets(tag, [asked_grid])
        == "tag:36h11:7 (a single tag, its border one bit wide) is there"
    )


def row_notes(asked, images):
    target = parse_targets([asked])[0]
    check = PhotographNotes([target], check_white=False)
    detector = make_detector(target)
    for image in images:
        check.add(image, [detector.detect(image)])
    return list(check.lines())


def test_the_board_without_the_rows_that_no_image_shows_is_named():
    for asked, there in [
        ("aprilgrid:3x5:40:0.3", "aprilgrid:3x3:40:0.3"),
        ("charuco:6x6:40:30:4X4_50", "charuco:6x5:40:30:4X4_50"),
        ("charuco:6x5:40:30:4X4_50:legacy", "charuco:6x4:40:30:4X4_50"),
        ("charuco:6x6:40:30:4X4_50:legacy", "charuco:6x4:40:30:4X4_50:legacy"),
    ]:
        (line,) = row_notes(asked, [drawn(there, 200)])
        assert line.startswith(f"{asked}: its last row is in 0 of 1 images")
        assert f"the board is {there}," in line
        assert row_notes(there, [drawn(there, 200)]) == []


@pytest.mark.slow
@pytest.mark.parametrize("asked", ["aprilgrid:3x4:40:0.3", "charuco:6x5:40:30:4X4_50"])
def test_a_row_that_one_image_shows_or_that_is_out_of_view_is_not_missed(asked):
    whole = drawn(asked, 200)
    if asked.startswith("aprilgrid"):  # its last row is the upper one
        whole = np.ascontiguousarray(whole[::-1, ::-1])
    end = 200 + int(0.7 * (len(whole) - 400))
    hidden = whole.copy()
    hidden[end:] = 120
    assert len(row_notes(asked, [hidden, hidden])) == 1
    assert row_notes(asked, [hidden, hidden, whole]) == []
    assert row_notes(asked, [whole[:end]]) == []


def image_of(name: str, response: str, z_m: float = 0.6, blur_px: float = 0.9) -> np.ndarray:
    """A target near the eye, as a camera of a response sees it, in colours."""
    camera, rendering = rig("simulated")
    blurred, rng = replace(rendering, blur_px=blur_px), np.random.default_rng(2)
    place = pose(0, 0, z_m, (0.2, 0.3, 0.1))
    drawn = scene(camera, make_planar_target(name), place, blurred, rng)
    encoded = np.interp(drawn.image, light_table(response), np.arange(256.0))
    return cv2.cvtColor(levels(encoded), cv2.COLOR_GRAY2BGR)


def response_lines(image, response):
    finder = TargetFinder([make_planar_target("checkerboard")], response=response)
    assert finder.find(image)
    return finder.response_check.lines()


@pytest.mark.slow
def test_encoded_levels_that_are_taken_for_light_are_noticed_and_no_others():
    for response in ("srgb", "linear"):
        image = image_of("checkerboard", response)
        assert response_lines(image, response) == []
        if response == "srgb":
            (line,) = response_lines(image, "linear")
            assert "were srgb, not linear" in line


@pytest.mark.slow
def test_a_lens_out_of_focus_is_no_response():
    """It blurs to a disk, whose edges are no Gaussian's, and even all the same."""
    sharp = image_of("checkerboard", "linear", 0.5, blur_px=0.3)[..., 0].astype(np.float32)
    side = np.arange(-4.0, 4.5, 0.5)
    for radius_px in (2.0, 2.5):
        disk = (np.hypot(*np.meshgrid(side, side)) < radius_px).astype(np.float32)
        disk = cv2.resize(disk, (9, 9), interpolation=cv2.INTER_AREA)
        blurred = levels(cv2.filter2D(sharp, -1, disk / disk.sum()))
        assert response_lines(blurred, "linear") == []


def test_few_edges_tell_nothing():
    check = LinearResponseCheck()
    image = image_of("tag", "srgb")
    check.add(image, TargetFinder([make_planar_target("tag")]).find(image), "linear")
    assert check.lines() == []
