"""Coverage of images and attitudes by views, and the advice that follows from it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.calibration.rigs import BOARD, as_calibrated, look, make_poses, make_rig
from vergence.calibration.adjustment import BoardPoses
from vergence.calibration.advice import (
    MOST_SENTENCES,
    advise_next_photographs,
    advise_on_bent_board,
    advise_on_distances,
    advise_on_empty_cells,
    advise_on_pair_motion,
    advise_on_tilts,
    advise_on_uncertain_corners,
    advise_on_uncertain_focal_lengths,
    advise_on_view_count,
    board_sag,
    board_tilts,
    views_per_cell,
)

MIDDLE = np.append(BOARD.corners_m.mean(axis=0), 0.0)
VIEWS = 60


def held(rotvecs_deg, middles_m):
    """Poses of boards that are turned, and whose middles are there."""
    rotation = Rotation.from_rotvec(rotvecs_deg, degrees=True).as_matrix()
    return BoardPoses(rotation, np.broadcast_to(middles_m, (len(rotation), 3)) - rotation @ MIDDLE)


def calibrated(poses, rng, rig=None, cameras=2):
    rig = rig or make_rig()
    seen = look(rig, poses, rng)
    if cameras == 1:
        rig, seen = rig.alone(0), seen.select_camera(0)
    return as_calibrated(rig, poses, seen)


@pytest.fixture(scope="module")
def good():
    """Boards into the corners of both images, tilted every way, near and far."""
    rng = np.random.default_rng(1)
    poses = make_poses(rng, 3 * VIEWS)
    z = np.repeat(rng.uniform(0.4, 1.2, VIEWS), 3)
    beside = np.column_stack([rng.uniform(-0.6, 0.6, len(z)) * z + 0.05,
                              rng.uniform(-0.45, 0.45, len(z)) * z, z])  # fmt: skip
    return calibrated(BoardPoses(poses.rotation, beside - poses.rotation @ MIDDLE), rng)


def facing(rng, tilt_deg=8.0, z_m=0.5):
    """Boards that barely tilt, all over the images and as far away."""
    rotvecs = rng.uniform(-tilt_deg, tilt_deg, (VIEWS, 3)) / np.sqrt(2.0)
    places = rng.uniform((-0.2, -0.15, z_m), (0.3, 0.15, z_m + 1e-9), (VIEWS, 3))
    return held(rotvecs, places)


def test_good_views_lack_nothing(good):
    assert advise_next_photographs(good) == []


def test_tilts_are_positive_if_the_lower_edge_is_nearer_and_cells_count_views():
    poses = held([[-30.0, 0.0, 0.0]] * 5, [0.05, 0.0, 0.5])
    lower = BOARD.corners_m[:, 1].argmax()
    depth = (poses.rotation[0] @ np.append(BOARD.corners_m[lower], 0.0) + poses.translation[0])[2]
    assert depth < 0.5
    found = calibrated(poses, np.random.default_rng(0))
    before = board_tilts(found)[0]
    np.testing.assert_allclose(before.tilt_deg, [[0.0, 30.0]] * 5, atol=1e-9)
    np.testing.assert_allclose(before.distance_m, np.hypot(0.05, 0.5))
    cells = views_per_cell(found, 0)  # views count, not corners
    assert cells[1, 1] == cells.max() == 5


def aside(rng):
    poses = make_poses(rng, VIEWS)
    left = poses.translation + poses.rotation @ MIDDLE
    left[:, 0] = -0.35 * left[:, 2] + 0.08
    return BoardPoses(poses.rotation, left - poses.rotation @ MIDDLE)


def one_sided(rng):
    """A turn about y, which points down, brings the right side nearer."""
    rotvecs = np.column_stack([rng.uniform(-40, 40, 30), rng.uniform(5, 40, 30), np.zeros(30)])
    return held(rotvecs, [0.05, 0.0, 0.5])


def far(rng):
    return held(rng.uniform(-40.0, 40.0, (30, 3)), [0.05, 0, 0.7])


@pytest.mark.parametrize(
    ("poses", "advise", "said"),
    [
        (aside, advise_on_empty_cells, "the right third of the left camera"),
        (facing, advise_on_tilts, "None of"), (facing, advise_on_distances, "farther away"),
        (one_sided, advise_on_tilts, "with its left side nearer"),
        (far, advise_on_uncertain_corners, "let the board reach"),
    ],
)  # fmt: skip
def test_what_the_views_lack_is_said(poses, advise, said):
    rng = np.random.default_rng(0)
    found = calibrated(poses(rng), rng)
    assert said in advise(found)
    if poses is not far:  # where two others come first
        assert advise(found) in advise_next_photographs(found)


def test_few_views_and_lost_views_are_said(good):
    rng = np.random.default_rng(0)
    rig, poses = make_rig(), make_poses(rng, 30)
    seen = look(rig, poses, rng)
    some = as_calibrated(rig, poses.select(np.arange(30) < 9), seen.select(np.arange(30) < 9))
    said = f"The calibration has {some.fit.kept_views.sum()} views: take 20 or more."
    assert advise_on_view_count(some) == said
    lost = as_calibrated(rig, poses, seen, dropped=range(12))
    said = f"{(~lost.fit.kept_views).sum()} of 30 views were left out"
    assert advise_on_view_count(lost).startswith(said)
    assert advise_on_view_count(good) == ""


def test_pairs_that_moved_between_the_exposures_are_said():
    rng = np.random.default_rng(0)
    rig, poses = make_rig(), make_poses(rng, VIEWS)
    seen = look(rig, poses, rng)
    found = as_calibrated(rig, poses, seen)
    assert advise_on_pair_motion(found) == ""
    moved = seen.pixels.copy()
    moved[1] += rng.normal(0.0, 2.0, (VIEWS, 1, 2))
    shaken = as_calibrated(rig, poses, replace(seen, pixels=moved))
    # each image by itself is as good as before: the board was merely elsewhere
    shaken = replace(shaken, single_fits=found.single_fits)
    assert "at the same moment" in advise_on_pair_motion(shaken)


def test_a_focal_length_that_is_not_known_well_is_said(good):
    unsure = replace(good, covariance=1e4 * good.covariance)
    assert advise_on_uncertain_focal_lengths(good) == ""
    assert "focal length is known to" in advise_on_uncertain_focal_lengths(unsure)


def test_the_sag_of_a_bent_board_is_that_of_its_farthest_corners():
    rng = np.random.default_rng(0)
    rig = make_rig()._replace(board_curvatures=np.array([0.5, 0.0, 0.0]))
    found = calibrated(make_poses(rng, 30), rng, rig)
    half = 0.5 * np.ptp(BOARD.corners_m[:, 0])
    np.testing.assert_allclose(board_sag(found).mm, 1e3 * 0.25 * half**2, rtol=1e-9)
    assert "bent by 2.3 mm" in advise_on_bent_board(found)


def test_advice_has_no_more_than_a_person_keeps_in_mind():
    rng = np.random.default_rng(0)
    found = calibrated(facing(rng).select(np.arange(8)), rng, cameras=1)
    assert len(advise_next_photographs(found)) == MOST_SENTENCES


def test_depth_noise_grows_with_the_square_of_the_distance_and_ends_where_an_image_does(good):
    depth = good.depth_sigma_at(np.array([0.05, 1.0, 2.0]))
    assert np.isnan(depth.total_m[0])
    # the cameras are turned by two degrees to each other, so that it is not quite four times
    np.testing.assert_allclose(depth.noise_m[2] / depth.noise_m[1], 4.0, rtol=0.1)
    # b f: z^2 / (b f) times the noise of a difference of two pixels
    expected = 1.0 / (0.1 * 522.0) * np.sqrt(2.0) * 0.1
    np.testing.assert_allclose(depth.noise_m[1], expected, rtol=0.15)
