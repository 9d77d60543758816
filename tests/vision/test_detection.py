"""Detected points against the projection of the target, and what is refused."""

import itertools
import pickle
import re
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.grids import some_of
from tests.naming import named, refused
from tests.vision.poses import pose
from tests.vision.scenes import CAMERA, RENDERING, scene, shifted
from vergence import load_head
from vergence.vision import (
    AprilGrid,
    AprilTag,
    BoardDetection,
    Camera,
    CharucoBoard,
    Checkerboard,
    TagFamily,
    Tracker,
    make_detector,
    make_planar_target,
    parse_target,
)

TARGETS = ("tag", "checkerboard")
GREY = np.full((480, 640), 120, np.uint8)


@pytest.mark.parametrize("name", TARGETS)
def test_no_bias_over_sub_pixel_shifts(name):
    """The mean over a pixel's phases is 0.01 px: half a pixel of convention would show."""
    target = make_planar_target(name)
    detector, errors = make_detector(target), []
    for phase in np.arange(0, 1, 0.125):
        wanted = np.array([505.0 + phase, 415.0 + phase])
        x, y = (wanted - CAMERA.principal) / CAMERA.focal
        image = scene(CAMERA, target, pose(x, y, 1.0), RENDERING).image
        errors.append(detector.detect(image).point_px - wanted)
    assert np.mean(errors, axis=0) == pytest.approx([0, 0], abs=0.01)
    assert np.abs(errors).max() < 0.04


def test_the_response_is_the_stated_one_the_cameras_or_that_of_the_images_kind():
    target = AprilTag()
    grey = scene(CAMERA, target, pose(0.0, 0.0, 1.0), RENDERING).image
    for of_camera, stated, colour, same_as in [
        (None, None, False, "linear"), (None, None, True, "srgb"), (2.2, None, True, 2.2),
        (2.2, "linear", True, "linear"),
    ]:  # fmt: skip
        image = np.repeat(grey[:, :, None], 3, axis=2) if colour else grey
        detector = make_detector(target, replace(CAMERA, response=of_camera), stated)
        expected = make_detector(target, CAMERA, same_as).detect(grey)
        with named(of_camera, stated, colour):
            for each in (detector, pickle.loads(pickle.dumps(detector))):
                np.testing.assert_array_equal(each.detect(image).corners_px, expected.corners_px)
    for text in ("checkerboard:9x6", "charuco:7x5:40:30:4X4_50", "aprilgrid:6x6:30:0.3"):
        detector = make_detector(parse_target(text), None, "sRGB")
        assert detector.response_of(np.zeros((9, 9), np.uint8)) == "srgb"


@pytest.mark.parametrize("target", [AprilTag(), TagFamily()], ids=str)
def test_threads_may_share_a_detector(target):
    """One with grey images, whose levels are light, and one with colour images, whose are not."""
    T_C_T = pose(0.02, 0.01, 1.0, (0.3, 0.2, 0.1))
    grey = scene(CAMERA, AprilTag(), T_C_T, RENDERING).image
    images = [grey, np.repeat(grey[:, :, None], 3, axis=2)]
    detector = make_detector(target, CAMERA)
    alone = [detector.detect(image).corners_px for image in images]
    assert (alone[0] != alone[1]).any()
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(detector.detect, 15 * images))
    for index, found in enumerate(together):
        assert (found.corners_px == alone[index % 2]).all()


def test_a_tag_is_found_and_tracked_in_the_same_place_in_an_image_of_more_bits():
    """Within 0.02 px: white is at another level, and the levels are rounded."""
    image = scene(CAMERA, AprilTag(), pose(0.02, 0.01, 0.8), RENDERING).image
    wide, detector = image.astype(np.uint16) << 4, make_detector(AprilTag(), CAMERA)
    plain = detector.detect(image)
    for found in (detector.detect(wide), detector.track(wide, plain)):
        assert found.corners_px == pytest.approx(plain.corners_px, abs=0.02)


@pytest.mark.slow
def test_tracked_equals_full_frame():
    """Both refinements end at one place, whether the prediction was near or far."""
    grid = AprilGrid(columns=4, rows=3, tag_m=0.04)
    targets = (AprilTag(), Checkerboard(), CharucoBoard(columns=5, rows=4, square_m=0.04), grid)
    for target, miss_px in some_of(targets, [(0, 0), (1.5, -2), (9, 7), (30, -20)]):
        with named(target, miss_px):
            detector, rng = make_detector(target), np.random.default_rng(0)
            before = detector.detect(scene(CAMERA, target, pose(0, 0, 1.0), RENDERING, rng).image)
            now = pose(0.05, -0.02, 1.02, (0, 0.05, 0))
            image = scene(CAMERA, target, now, RENDERING, rng).image
            full = detector.detect(image)
            shift = full.point_px + miss_px - before.point_px
            tracked = detector.track(image, shifted(before, shift))
            # fewer pixels take part where a tag is tracked
            assert tracked.point_px == pytest.approx(full.point_px, abs=0.03)
            assert tracked.corners_px == pytest.approx(full.corners_px, abs=0.06)


@pytest.mark.slow
@pytest.mark.parametrize("side", [(1, 0), (0, -1)])
def test_a_checkerboard_whose_middle_the_frames_edge_cuts_is_none(side):
    target = Checkerboard()
    detector = make_detector(target)
    before = detector.detect(scene(CAMERA, target, pose(0, 0, 1.0), RENDERING).image)
    middle = (np.array(target.cells.shape[::-1]) / 2 - target.origin_cells) * target.cell_m
    edge = np.array(side) * (CAMERA.width / 2, CAMERA.height / 2) / CAMERA.focal
    cut = scene(CAMERA, target, pose(*(edge - middle), 1.0), RENDERING)
    assert detector.detect(cut.image) is None
    assert detector.track(cut.image, shifted(before, cut.point - before.point_px)) is None


@pytest.mark.parametrize(
    ("name", "angle"), [("tag", 0.7), ("checkerboard", 0.0), ("checkerboard", np.pi / 2)]
)
def test_motion_blinds_before_it_misleads(name, angle):
    """Up to 5 px of smear are seen, and what is seen of longer ones is right."""
    target, T_C_T = make_planar_target(name), pose(0.0, 0.0, 1.0, (0.1, -0.2, 0.1))
    detector = make_detector(target)
    before = detector.detect(scene(CAMERA, target, T_C_T, RENDERING).image)
    for length in np.arange(1.0, 16.0, 2.0):
        smear, rng = length * np.array([np.cos(angle), np.sin(angle)]), np.random.default_rng(4)
        image = scene(CAMERA, target, T_C_T, RENDERING, rng, smear).image
        seen = detector.track(image, before)
        if length <= 5:
            assert seen is not None
        if seen is not None:
            away = np.abs(seen.point_px - before.point_px).max()
            assert away < max(0.25, 3.0 * seen.sigma_px.max())


# where nothing is

SIZE = (120, 160)
OFTEN_MISTAKEN = {
    **{
        family: TagFamily(family=family)
        for family in ("36h11", "36h10", "25h9", "16h5", "Standard41h12", "Circle21h7")
    },
    "5x4": Checkerboard(columns=5, rows=4),
    "3x3": Checkerboard(columns=3, rows=3),
    "charuco": CharucoBoard(columns=5, rows=4),
    "aprilgrid": AprilGrid(columns=2, rows=2),
}


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


def letters(rng: np.random.Generator) -> np.ndarray:
    """A page of text."""
    image = np.full(SIZE, 240, np.uint8)
    for line in range(4):
        text = "".join(chr(c) for c in rng.integers(33, 127, 16))
        cv2.putText(image, text, (5, 18 + 20 * line), cv2.FONT_HERSHEY_SIMPLEX, 0.5, 20, 1)
    return image


def images() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    out = {"black": np.zeros(SIZE, np.uint8), "white": np.full(SIZE, 255, np.uint8)}
    for k in range(2):
        # small: OpenCV finds hundreds of squares in it, and compares each with all tags
        out[f"noise {k}"] = rng.integers(0, 256, (60, 80), np.uint8)
        out[f"boxes {k}"] = boxes(rng)
        out[f"tiles {k}"] = tiles(rng, 6 + 8 * k)
        out[f"letters {k}"] = letters(rng)
    v, u = np.indices(SIZE)
    for square in (8, 13, 30):
        floor = (u // square + v // square) % 2 * 170 + 40
        out[f"floor {square}"] = floor.astype(np.uint8)
    return out


IMAGES = images()


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=pytest.mark.slow) if n == "5x4" else n for n in OFTEN_MISTAKEN],
)
def test_nothing_is_found_where_nothing_is(name):
    """On no floor of tiles, and in a third of the other images; in all for the default tag."""
    detector, place = make_detector(OFTEN_MISTAKEN[name]), list(OFTEN_MISTAKEN).index(name)
    for k, (kind, image) in enumerate(IMAGES.items()):
        if name == "36h11" or "floor" in kind or (k + (k - 2) // 4 + place) % 3 == 0:
            with named(kind):
                assert detector.detect_all(image) == []


# wrong arguments

NONE = np.full((4, 2), np.nan)
SEEN = BoardDetection(AprilTag(), NONE[0], NONE, NONE[0], NONE)
TAG = make_detector(AprilTag())
CHARUCO = make_detector(parse_target("charuco:7x5:40:30:4X4_50"))
MIRROR = np.diag([1.0, 1.0, -1.0, 1.0])


def test_what_was_expected_is_said():
    for call, expected in [
        (lambda: make_detector("tag:36h11"), "target: expected a target, as parse_target makes"),
        (lambda: parse_target(None), "target: expected a printed board"),
        (lambda: Camera.of("head.toml", 0), "head: expected a head, see load_head"),
        (lambda: Camera.of(load_head("simulated"), 2), "eye: expected 0 for left or 1"),
        (lambda: TAG.detect(GREY, near_px=(np.nan, 1)), "near_px: expected a pixel (u, v)"),
        (lambda: TAG.search(GREY, near_px="there"), "near_px: expected a pixel (u, v)"),
        (lambda: TAG.search(GREY, way="half"), "way: expected a whole number or None"),
        (lambda: TAG.track(GREY, None), "predicted: expected a detection of tag:36h11:0"),
        (lambda: CHARUCO.track(GREY, SEEN), "predicted: expected a detection of charuco:7x5:40:30"),
        (
            lambda: TAG.track(GREY, SEEN._replace(corners_px=NONE[:3])),
            "predicted: expected corners_px of shape (4, 2), got (3, 2)",
        ),
        (lambda: Tracker(TAG).find(GREY, "left"), "predicted_px: expected a pixel (u, v)"),
        (lambda: Tracker(TAG).find(GREY, T_0_C="here"), "T_0_C: expected a pose (4, 4)"),
        (lambda: Tracker(TAG).find(GREY, T_0_C=MIRROR), "T_0_C: expected a pose (4, 4) with a"),
    ]:
        refused(re.escape(expected), call)


def test_a_prediction_that_is_nowhere_finds_nothing():
    names = ("tag:36h11:0", "checkerboard:5x4", "charuco:7x5:40:30:4X4_50", "aprilgrid:6x6:88:0.3")
    for name, where in itertools.product(names, (np.nan, np.inf, 1e300)):
        with named(name, where):
            detector = make_detector(parse_target(name))
            corners = np.full((len(detector.target.corners_m), 2), where)
            seen = BoardDetection(detector.target, corners[0], corners, corners[0], corners)
            assert detector.track(GREY, seen) is None
