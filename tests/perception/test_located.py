"""Targets at known places come out there, as surely as they say."""

from dataclasses import replace

import numpy as np
import pytest

from tests.heads import head_of
from tests.naming import named
from tests.perception.drawn import Studio, corners_in_space, pose_at
from vergence import load_head
from vergence.perception.finding import (
    TargetFinder,
    centre_weights,
    target_centre_px,
    weighted_sum,
)
from vergence.perception.locate import locate_target, measure_spacing, neighbour_distances_m
from vergence.triangulation import Noise
from vergence.vision import BoardDetection, Camera
from vergence.vision.targets import AprilTag, Checkerboard, neighbour_pairs

BOARD = Checkerboard(columns=5, rows=4, square_m=0.03)
TARGETS = [AprilTag(id=5, edge_m=0.12), BOARD]
PLACE = [0.02, 0.03, 0.6]
POSE = pose_at(PLACE, [0.2, -0.4, 0.1])


def exact(head, q, target, pose, sigma=0.05):
    """Both eyes' detections of a target at a pose, without noise."""
    pixels = head.project(q, corners_in_space(target, pose))
    centre = head.project(q, pose[:3, 3])
    return [
        BoardDetection(
            target, centre[eye], pixels[:, eye], np.full(2, sigma), np.full((len(pixels), 2), sigma)
        )
        for eye in range(2)
    ]


@pytest.mark.parametrize("name", ["physical", "icub"])
def test_exact_pixels_give_exact_points(name):
    head = load_head(name)
    q = head.fixate(PLACE)
    for target in TARGETS:
        one = locate_target(head, q, "a", *exact(head, q, target, POSE))
        points = corners_in_space(target, POSE)
        np.testing.assert_allclose(one.fix.point, points, atol=1e-8)
        np.testing.assert_allclose(one.centre.point, points.mean(axis=0), atol=1e-8)
        assert one.spacing.mean_m == pytest.approx(target.cell_m * (8 if len(points) == 4 else 1))


def test_the_centre_of_a_board_is_surer_than_its_corners_only_as_far_as_pixels_go():
    for head, averages in ((head_of("pair"), True), (load_head("physical"), False)):
        seen = exact(head, head.rest(), BOARD, pose_at([0.0, 0.0, 0.6]))
        one = locate_target(head, head.rest(), "a", *seen)
        ratio = one.fix.sigma[:, 2].mean() / one.centre.sigma[2]
        # 20 corners: sqrt(20) where pixels alone err, 1 where the encoders' steps err in common
        assert ratio == pytest.approx(np.sqrt(20.0), rel=0.05) if averages else 1.0 <= ratio < 1.2


def test_a_symmetric_board_is_matched_however_its_corners_were_counted():
    head = head_of("pair")
    T_C_N = np.linalg.inv(head.camera_poses(head.rest()))
    # in a quarter turn, boards that are not square or have an odd number change shape or colours
    for columns, rows, turns in [(6, 4, 2), (7, 5, 2), (5, 5, 2), (4, 4, 1), (4, 4, 2), (4, 4, 3)]:
        with named(columns, rows, turns):
            board = Checkerboard(columns=columns, rows=rows, square_m=0.03)
            left, right = exact(head, head.rest(), board, pose_at([0.0, 0.0, 0.6], [0.3, 0.1, 0.0]))
            order = np.rot90(np.arange(columns * rows).reshape(rows, columns), turns).ravel()
            right = right._replace(corners_px=right.corners_px[order])
            one = locate_target(head, head.rest(), "a", left, right)
            assert one.gap_m < 1e-8
            for found, truth in zip(one.eye_poses, T_C_N @ one.pose.matrix, strict=True):
                np.testing.assert_allclose(found.matrix, truth, atol=1e-6)
            assert one.spacing.mean_m == pytest.approx(0.03)


def test_a_missing_corner_is_null_and_the_others_are_there():
    head = head_of("pair")
    left, right = exact(head, head.rest(), BOARD, pose_at([0.0, 0.0, 0.6]))
    for eye, corner in ((left, 3), (right, 7)):
        eye.corners_px[corner] = np.nan
        eye.corners_sigma_px[corner] = np.nan
    row = locate_target(head, head.rest(), "a", left, right).document()
    assert [i for i, point in enumerate(row["points_mm"]) if point is None] == [3, 7]
    assert [i for i, sigma in enumerate(row["sigma_mm"]) if sigma is None] == [3, 7]
    assert [i for i, gap in enumerate(row["gap_mm"]) if gap is None] == [3, 7]
    assert [pixel is None for pixel in (row["pixels"][0][3], row["pixels"][1][3])] == [True, False]
    np.testing.assert_allclose(row["centre_mm"], [-60.0, 45.0, 600.0], atol=1e-5)


def test_the_pose_is_that_of_the_target_if_its_size_is_known_or_not():
    head = load_head("physical")
    q = head.fixate(PLACE)
    for target, size in zip(TARGETS, ("edge_m", "square_m"), strict=True):
        sides = exact(head, q, target, POSE)
        known = locate_target(head, q, "a", *sides)
        unknown = replace(target, **{size: 0.2, "size_known": False})
        other = locate_target(head, q, "a", *(side._replace(target=unknown) for side in sides))
        for one in (known, other):
            np.testing.assert_allclose(one.pose.matrix, POSE, atol=1e-6)
        for T, found in zip(head.camera_poses(q), known.eye_poses, strict=True):
            np.testing.assert_allclose(T @ found.matrix, POSE, atol=1e-6)
        of_eye = other.document()["eye_poses"]["left"]  # which does not know how large it is
        assert of_eye["translation_mm"] is of_eye["sigma_mm"] is None
        assert of_eye["rotation_vector_rad"] == pytest.approx(
            known.eye_poses[0].rotation_vector.tolist(), abs=1e-6
        )
        assert (other.pose.sigma[:3] > known.pose.sigma[:3]).all()
        assert known.pose.sigma[2] < known.eye_poses[0].sigma[2]


def test_corners_that_no_pose_explains_say_so_and_name_no_second_tilt():
    head = load_head("physical")
    q = head.fixate(PLACE)
    for target in TARGETS:
        sides = exact(head, q, target, POSE)
        assert not locate_target(head, q, "a", *sides).pose.contradicted
        wrong = locate_target(head, q + [0, 0, 0, 0.05, 0.05, 0, 0], "a", *sides)
        assert wrong.pose.contradicted
        assert wrong.document()["pose"]["contradicted"]
        assert wrong.pose.other is None


@pytest.mark.nightly
@pytest.mark.parametrize("target", TARGETS, ids=["tag", "board"])
def test_points_of_drawn_images_lie_within_their_own_sigma(target):
    # the pair's head has no encoders: what is left is the detector's noise, which it states itself
    head = load_head("physical").replace(sensor={"encoder_resolution_rad": 0.0})
    q = head.fixate([0.0, 0.0, 0.8])
    studio = Studio(head, target, q)
    finders = [TargetFinder([target], Camera.of(head, eye)) for eye in range(2)]
    rng = np.random.default_rng(11)
    squares = []
    for _ in range(6):
        pose = pose_at([*rng.uniform(-0.08, 0.08, 2), rng.uniform(0.6, 1.0)], rng.normal(0, 0.2, 3))
        found = [
            finder.find(image)
            for finder, image in zip(finders, studio.take(pose, rng), strict=True)
        ]
        one = locate_target(head, q, "a", found[0][0], found[1][0])
        error = one.fix.point - corners_in_space(target, pose)
        squares.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(one.fix.covariance), error))
    # three coordinates: 3 in the mean; poses are independent, corners of one pose nearly so
    assert 1.5 < np.mean(squares) < 4.5
    assert np.mean(np.concatenate(squares) < 9.0 * 3.0) > 0.99


@pytest.mark.slow
@pytest.mark.parametrize(("name", "target"), [("icub", TARGETS[0]), ("pair", BOARD)])
def test_the_mean_edge_errs_as_much_as_it_says(name, target):
    head = head_of(name) if name == "pair" else load_head(name)
    q = head.fixate(PLACE) if head.actuation.count else head.rest()
    sides = exact(head, q, target, POSE, 0.1)
    steps, rng = Noise.of(head).joint_rad, np.random.default_rng(4)
    means, said = [], []
    for _ in range(200):
        turned = q + head.actuation.joint_velocities_of(
            rng.normal(0.0, steps) * (np.arange(7) >= 3)
        )
        noisy = [
            d._replace(corners_px=d.corners_px + rng.normal(0.0, 0.1, d.corners_px.shape))
            for d in sides
        ]
        one = locate_target(head, turned, "a", *noisy)
        means.append(one.spacing.mean_m)
        said.append(one.spacing.sigma_m)
    # 200 draws: a standard deviation is known to 5 %; it is of first order
    assert np.std(means) == pytest.approx(np.mean(said), rel=0.16)


def test_a_board_and_a_part_of_it_have_one_middle_on_a_plane_in_space_and_a_line_has_none():
    weights = centre_weights(BOARD.corners_m, np.ones(20, bool))
    np.testing.assert_allclose(weights, 1.0 / 20.0, atol=1e-12)
    rng = np.random.default_rng(0)
    whole = BOARD.corners_m @ rng.normal(size=(2, 3))
    points = whole + rng.normal(size=3)
    for seen in ([0, 1, 2, 6, 7], [], [3], [0, 4], [0, 1, 2, 3]):
        found = np.isin(np.arange(20), seen)
        weights = centre_weights(BOARD.corners_m, found)
        if len(seen) < 5:
            assert np.isnan(weights).all(), seen
            continue
        middle = weighted_sum(np.where(found[:, None], points, np.nan), weights)
        np.testing.assert_allclose(middle - points[0], whole.mean(axis=0) - whole[0], atol=1e-9)


def test_the_pixel_of_the_middle_is_where_the_lens_puts_it():
    head = load_head("physical")
    camera, pose = Camera.of(head, 0), pose_at([0.08, -0.05, 0.4], [0.0, 0.6, 0.0])
    seen, _ = exact(head, head.rest(), BOARD, pose)
    true = head.project(head.rest(), corners_in_space(BOARD, pose).mean(axis=0))[0]
    pixel, sigma = target_centre_px(seen, camera)
    np.testing.assert_allclose(pixel, true, atol=1e-6)
    np.testing.assert_allclose(sigma, 0.05 / np.sqrt(20.0), atol=1e-12)
    seen.corners_px[[0, 3, 7, 11]] = np.nan
    np.testing.assert_allclose(target_centre_px(seen, camera)[0], true, atol=1e-6)
    seen.corners_px[5:] = np.nan
    assert np.isnan(target_centre_px(seen, camera)[0]).all()


def test_neighbours_are_an_edge_apart():
    assert len(neighbour_pairs(BOARD)) == 4 * 4 + 5 * 3
    assert len(neighbour_pairs(AprilTag())) == 4
    points = np.column_stack([BOARD.corners_m, np.zeros(20)])
    np.testing.assert_allclose(neighbour_distances_m(BOARD, 1.01 * points), 0.0303, atol=1e-12)
    points[0] = np.nan
    spacing = measure_spacing(BOARD, [points, 1.02 * points])
    assert spacing[:4] == pytest.approx((0.0303, 0.0003, 2 * 29, 0.03))


def test_what_was_not_stated_and_what_was_not_found_is_none_in_json():
    unsaid = Checkerboard(columns=5, rows=4, size_known=False)
    nothing = np.full((20, 3), np.nan)
    assert measure_spacing(unsaid, [nothing]).document() == {
        "mean": None, "spread": None, "count": 0, "stated": None,
    }  # fmt: skip
