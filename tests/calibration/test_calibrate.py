"""Calibration from corners: the true cameras, bad views left out, what cannot be is refused."""

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.calibration.rigs import BOARD, SIZE, look, make_poses, make_rig
from tests.naming import named
from tests.vision.poses import pose
from tests.vision.scenes import rig, scene
from vergence.calibration import cameras
from vergence.calibration.adjustment import BoardPoses
from vergence.calibration.advice import advise_next_photographs
from vergence.calibration.calibrate import (
    calibrate_views,
    head_file_text,
    ros_camera_document,
)
from vergence.calibration.observations import alike_views, detect_board_corners
from vergence.calibration.uncertainty import right_camera_pose_covariance
from vergence.errors import ConfigurationError
from vergence.models import parse_head
from vergence.vision import Checkerboard, make_detector, parse_target

LENS = "brown-conrady"


@pytest.fixture(autouse=True)
def few_starts(request, monkeypatch):
    """Fewer samples to begin with, which only bad views need, and two folds: half of the time."""
    monkeypatch.setattr(cameras, "_SAMPLE_COUNT", 6 if "bad_views" in request.node.name else 2)
    if "lens_is_told" not in request.node.name:
        monkeypatch.setattr(cameras, "FOLDS", 2)


@pytest.fixture(scope="module")
def pair():
    """Observations of a board by two cameras in 16 views, and the cameras."""
    rng = np.random.default_rng(3)
    rig = make_rig()
    return look(rig, make_poses(rng, 16), rng), rig


@pytest.fixture(scope="module")
def found(pair):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cameras, "_SAMPLE_COUNT", 2)
        patch.setattr(cameras, "FOLDS", 2)
        return calibrate_views(pair[0], LENS)


def picked(seen, views):
    """Some views of observations, in any order and any number of times."""
    names = tuple(tuple(row[view] for view in views) for row in seen.file_names)
    return replace(seen, file_names=names, pixels=seen.pixels[:, views], sigma=seen.sigma[:, views])


def both(seen):
    return np.flatnonzero(seen.usable.all(axis=0))


@pytest.mark.slow
@pytest.mark.parametrize("lens", ["brown-conrady", "fisheye"])
@pytest.mark.parametrize("cameras", [1, pytest.param(2, marks=pytest.mark.nightly)])
def test_the_lens_is_told(lens, cameras):
    rng = np.random.default_rng(5)
    focal, wide = (220.0, 3.5) if lens == "fisheye" else (520.0, 1.0)
    rig = make_rig(lens, focal)
    seen = look(rig, make_poses(rng, 16, wide=wide), rng)
    found = calibrate_views(seen if cameras == 2 else seen.select_camera(0))
    assert found.lens == lens
    true = (rig if cameras == 2 else rig.alone(0)).packed()
    assert np.abs((found.rig.packed() - true) / found.sigma).max() < 4.0


@pytest.mark.slow
def test_the_cameras_are_found(pair, found):
    rig = pair[1]
    assert np.abs((found.rig.packed() - rig.packed()) / found.sigma).max() < 4.0
    baseline, sigma = found.baseline_mm
    assert abs(baseline - 1e3 * np.linalg.norm(rig.translation)) < 4.0 * sigma
    assert all(one.why.startswith("the board was not found") for one in found.dropped)


@pytest.mark.slow
def test_the_head_file_has_the_cameras_and_their_deviations(found):
    head = parse_head(head_file_text(found, "desk", "srgb"))
    assert head.cameras.response == ("srgb", "srgb")
    left, right = head.camera_poses(head.rest())
    between = np.column_stack([found.rig.rotation, found.rig.translation])
    np.testing.assert_allclose((np.linalg.inv(right) @ left)[:3], between, atol=1e-9)
    record = head.calibration
    assert record.views == found.fit.kept_views.sum()
    assert record.corners_sha256 == found.observations.digest
    assert record.sigma["left.camera.f_u"] == pytest.approx(found.sigma[0])
    # the position along the baseline is as sure as the baseline, but for their small angle
    assert record.sigma["right.head_eye.x"] == pytest.approx(1e-3 * found.baseline_mm[1], rel=0.05)


@pytest.mark.slow
def test_the_covariance_of_the_place_follows_small_changes(pair):
    _, rig = pair
    rng = np.random.default_rng(0)
    root = 1e-4 * rng.standard_normal((6, 6))
    between = rig.blocks[-2]
    draws = root @ rng.standard_normal((6, 1000))
    row = rig.packed()
    moved = []
    for step in draws.T:
        row[between] = rig.packed()[between] + step
        one = rig.unpacked(row)
        spin = Rotation.from_matrix(rig.rotation @ one.rotation.T).as_rotvec()
        place = -one.rotation.T @ one.translation + rig.rotation.T @ rig.translation
        moved.append([*spin, *place])
    told = np.sqrt(np.diagonal(right_camera_pose_covariance(rig, root @ root.T)))
    np.testing.assert_allclose(np.std(moved, axis=0), told, rtol=0.1)


@pytest.mark.slow
def test_one_camera_gives_a_file_of_its_own(pair):
    found = calibrate_views(pair[0].select_camera(0), LENS)
    document = ros_camera_document(found)
    assert (document["image_width"], document["image_height"]) == (640, 480)
    assert document["distortion_model"] == "plumb_bob"
    assert document["calibration"]["sigma"]["f_u"] == pytest.approx(found.sigma[0])
    assert "baseline_mm" not in found.document()


@pytest.mark.slow
def test_a_fifth_of_bad_views_changes_nothing(pair, found):
    seen, _ = pair
    bad = both(seen)[::5]
    pixels = seen.pixels.copy()
    pixels[1, bad] += (6.0, 0.0)
    fewer = calibrate_views(replace(seen, pixels=pixels), LENS)
    assert not fewer.fit.kept_views[bad].any()
    # a fifth of the views tells half a deviation
    assert np.abs((fewer.rig.packed() - found.rig.packed()) / found.sigma).max() < 2.0
    assert {one.view for one in fewer.dropped} >= {f"l{view}.png" for view in bad}


@pytest.mark.slow
def test_two_pairs_of_five_may_be_left_out(pair):
    few = picked(pair[0], both(pair[0])[:5])
    pixels = few.pixels.copy()
    pixels[1, :2] += np.array([[6.0, 3.0], [-9.0, -4.5]])[:, None]
    found = calibrate_views(replace(few, pixels=pixels), LENS)
    assert found.fit.kept_views.sum() == 3
    assert np.isfinite(found.held_out_px).all()


@pytest.mark.slow
def test_a_mistaken_corner_is_left_out_and_its_view_stays(pair):
    seen, _ = pair
    pixels = seen.pixels.copy()
    view = int(both(seen)[2])
    pixels[0, view, 8] += (30.0, -40.0)
    found = calibrate_views(replace(seen, pixels=pixels).select_camera(0), LENS)
    assert found.fit.kept_views[view]
    assert found.rms_alone_px[0] < 0.2
    assert found.observations.remarks[0].startswith("1 corner left out")
    assert re.search(rf"l{view}.png \((49|50)\.. px\)", found.observations.remarks[0])


@pytest.mark.slow
def test_views_of_a_board_at_rest_count_as_one(pair):
    views, left = both(pair[0])[:8], pair[0].select_camera(0)
    seen, rng = picked(left, np.repeat(views, 2)), np.random.default_rng(1)
    noisy = replace(seen, pixels=seen.pixels + 0.1 * rng.standard_normal(seen.pixels.shape))
    found = calibrate_views(noisy, LENS)
    once = calibrate_views(picked(left, views), LENS)
    assert found.fit.kept_views.tolist() == [True, False] * len(views)
    assert found.sigma == pytest.approx(once.sigma, rel=0.8)
    assert "views are like others but for noise" in found.observations.remarks[0]


def test_views_that_differ_a_little_are_views_of_their_own(pair):
    seen = picked(pair[0], np.repeat(both(pair[0]), 2))
    seen.pixels[:, 1::2] += 0.7
    assert not alike_views(seen.pixels, seen.sigma)


@pytest.mark.slow
def test_corners_of_a_board_that_looks_the_same_turned_are_matched():
    rng = np.random.default_rng(4)
    board = parse_target("checkerboard:8x6:24")
    assert board.symmetric
    rig = make_rig()
    seen = look(rig, make_poses(rng, 16, board), rng, board=board)
    pixels = seen.pixels.copy()
    pixels[1, ::2] = pixels[1, ::2, ::-1]
    found = calibrate_views(replace(seen, pixels=pixels), LENS)
    baseline, sigma = found.baseline_mm
    assert abs(baseline - 1e3 * np.linalg.norm(rig.translation)) < 4.0 * sigma


@pytest.mark.slow
def test_lengths_scale_with_the_stated_square(pair, found):
    larger = replace(BOARD, square_m=1.01 * BOARD.square_m)
    second = calibrate_views(replace(pair[0], target=larger), LENS)
    assert second.baseline_mm[0] == pytest.approx(1.01 * found.baseline_mm[0], rel=1e-6)
    same = pytest.approx(found.rig.camera_parameters[0], rel=1e-4)
    assert second.rig.camera_parameters[0] == same


@pytest.mark.slow
def test_what_gives_no_pair_is_refused(pair):
    seen = picked(pair[0], both(pair[0])[:6])
    views = np.arange(6)
    exchanged = replace(seen, pixels=seen.pixels[::-1], sigma=seen.sigma[::-1])
    shuffled = replace(seen, pixels=np.stack([seen.pixels[0], np.roll(seen.pixels[1], 1, axis=0)]))
    alike = picked(seen, [views[0]] * 12)
    rng = np.random.default_rng(2)
    alike = replace(alike, pixels=alike.pixels + 0.02 * rng.standard_normal(alike.pixels.shape))
    tiny = replace(seen, target=replace(BOARD, square_m=0.001 * BOARD.square_m))
    for case, message in (
        (picked(seen, views[:4]), "at least 5 photographs of a camera, better 20, found it in 4"),
        (exchanged, "on its left: exchange --left and --right"),
        (shuffled, "does each left image go with its right one"),
        (alike, "found it in 1 of 12 .11 are like others but for noise"),
        (tiny, "is the square's size in millimetres"),
        (
            replace(seen, target=replace(BOARD, size_known=False)),
            "expected the size of a square, which the baseline needs",
        ),
    ):
        with named(message), pytest.raises(ConfigurationError, match=message):
            calibrate_views(case, LENS)


@pytest.mark.slow
def test_a_right_camera_that_is_upside_down_is_said(pair):
    seen = picked(pair[0], both(pair[0])[:6])
    pixels = seen.pixels.copy()
    pixels[1] = np.subtract(SIZE, 1.0) - pixels[1]
    said = advise_next_photographs(calibrate_views(replace(seen, pixels=pixels), LENS))
    assert "the right camera is turned by 180 degrees" in said[-1]


@pytest.mark.nightly
def test_boards_that_all_face_the_camera_are_refused():
    rng = np.random.default_rng(6)
    poses = make_poses(rng, 6)
    facing = np.broadcast_to(np.eye(3), poses.rotation.shape)
    flat = BoardPoses(facing, np.column_stack([poses.translation[:, :2], np.full(6, 0.5)]) - 0.05)
    with pytest.raises(ConfigurationError, match="tilt the board by some 30 degrees"):
        calibrate_views(look(make_rig(), flat, rng).select_camera(0), LENS)


def photographed(target):
    """The image of a target before a camera, and the camera."""
    camera, rendering = rig("physical")
    return scene(camera, target, pose(0.02, 0.01, 0.7), rendering).image, camera


def test_photographs_with_colours_are_measured_by_srgb_and_grey_ones_as_they_are(tmp_path):
    tag = parse_target("tag:36h11:5:120")
    image, _ = photographed(tag)
    left, right = tmp_path / "left.png", tmp_path / "right.png"
    cv2.imwrite(str(left), cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    cv2.imwrite(str(right), image)
    seen, _ = detect_board_corners(tag, [[left], [right]])
    stated, _ = detect_board_corners(tag, [[left], [right]], responses=("srgb", "linear"))
    np.testing.assert_array_equal(seen.pixels, stated.pixels)
    assert not np.array_equal(seen.pixels[0], seen.pixels[1])


@pytest.mark.slow
def test_corners_of_a_soft_image_that_was_halved_are_in_its_own_pixels(tmp_path):
    board = Checkerboard(columns=5, rows=4, square_m=0.03)
    sharp, camera = photographed(board)
    corners = make_detector(board, camera).detect(sharp).corners_px
    soft = cv2.GaussianBlur(cv2.resize(sharp, None, fx=4, fy=4), (0, 0), 24)
    assert make_detector(board).detect(soft) is None
    cv2.imwrite(str(tmp_path / "soft.png"), soft)
    seen, _ = detect_board_corners(board, [[tmp_path / "soft.png"]])
    off = seen.pixels[0, 0] - (4.0 * (corners + 0.5) - 0.5)
    assert np.abs(off.mean(axis=0)).max() < 0.25  # a centre that moves by halving moves 0.5 px
