"""Bundle adjustment: exact Jacobians, the true numbers back, deviations that are true."""

import numpy as np
import pytest

from tests.calibration.rigs import COEFFICIENTS, SIZE, differences, make_poses, make_rig
from tests.calibration.rigs import look as look_at
from vergence.calibration.adjustment import BoardPoses, BundleAdjustment, project_with_jacobians
from vergence.calibration.uncertainty import rig_covariance
from vergence.models.camera import rays_to_pixels
from vergence.models.lens import pack_camera


@pytest.fixture
def rng():
    return np.random.default_rng(7)


@pytest.mark.parametrize("lens", COEFFICIENTS)
def test_pixels_are_those_of_the_kernels_and_derivatives_those_of_small_steps(lens, rng):
    points = np.column_stack([rng.uniform(-0.4, 0.4, (30, 2)), rng.uniform(0.6, 1.0, 30)])
    values = make_rig(lens).camera_parameters[0]
    found = project_with_jacobians(lens, values, points)
    row = pack_camera(SIZE, values[:2], values[2:4], lens, values[4:])
    expected = rays_to_pixels(points[:, :2] / points[:, 2:], row)
    np.testing.assert_allclose(found.pixels, expected, atol=1e-10)
    by_point = differences(lambda d: project_with_jacobians(lens, values, points + d).pixels, 3)
    by_camera = differences(
        lambda d: project_with_jacobians(lens, values + d, points).pixels, len(values)
    )
    np.testing.assert_allclose(found.point_jacobian, by_point, atol=1e-5)
    np.testing.assert_allclose(found.camera_jacobian, by_camera, atol=1e-5)
    assert np.isnan(project_with_jacobians(lens, values, np.array([0.0, 0.0, -1.0])).pixels).all()


@pytest.mark.parametrize("lens", ["rational", "fisheye"])
def test_jacobians_are_those_of_small_steps(lens, rng):
    rig, poses = make_rig(lens), make_poses(rng, 2)
    rig = rig._replace(board_curvatures=np.array([0.02, -0.1, 0.03]))
    problem = look_at(rig, poses, rng).problem
    row, by_place = rig.packed(), np.zeros((len(rig.packed()), 2, problem.pixels[0].size))
    for camera, (_, jacobian, columns) in enumerate(problem.rows(rig, poses)):
        by_place[columns, camera] = jacobian[..., :-6].reshape(-1, len(columns)).T
    for place in range(len(row)):
        step = 1e-5 * max(abs(row[place]), 0.1) * np.eye(len(row))[place]
        moved = (rig.unpacked(row + step), rig.unpacked(row - step))
        ahead, behind = (problem.residuals(one, poses) for one in moved)
        expected = ((ahead - behind) / (2.0 * step[place])).reshape(2, -1)
        scale = np.abs(expected).max()
        np.testing.assert_allclose(by_place[place], expected, atol=1e-5 * scale + 1e-5)


def test_exact_corners_give_the_true_numbers_back(rng):
    rig, poses = make_rig(), make_poses(rng, 8)
    rig = rig._replace(board_curvatures=np.array([0.0, 0.1, 0.0]))
    problem = look_at(rig, poses, rng, noise_px=0.0).problem
    problem = BundleAdjustment(problem.board_corners, problem.pixels, np.ones_like(problem.pixels))
    start = rig.unpacked(rig.packed() * (1.0 + 1e-3 * rng.standard_normal(len(rig.packed()))))
    moved = BoardPoses(poses.rotation, poses.translation + 0.003)
    found = problem.solve(start, moved)
    np.testing.assert_allclose(found.rig.packed(), rig.packed(), rtol=1e-5, atol=1e-6)


@pytest.mark.slow
def test_errors_are_of_the_size_of_their_covariance(rng):
    rig, squares = make_rig(), []
    for _ in range(6):
        poses = make_poses(rng, 14)
        seen = look_at(rig, poses, rng)
        views = seen.usable.any(axis=0)
        found = seen.problem.select(views).solve(rig, poses.select(views))
        error = found.rig.packed() - rig.packed()
        squares.append(error @ np.linalg.solve(rig_covariance(found), error) / len(error))
    # 6 draws of 27 numbers: the mean scatters by 0.11
    assert 0.65 < np.mean(squares) < 1.35


def test_a_board_that_moved_between_exposures_makes_the_baseline_less_sure(rng):
    rig, poses = make_rig(), make_poses(rng, 20)
    still = look_at(rig, poses, rng)
    moved = BoardPoses(poses.rotation, poses.translation + 0.0005 * rng.standard_normal((20, 3)))
    views = still.usable.all(axis=0)
    pixels = still.pixels.copy()
    pixels[1] = look_at(rig, moved, rng).pixels[1]
    views &= np.isfinite(pixels).all(axis=(0, 2, 3))
    seen, corners = (still.pixels[:, views], pixels[:, views]), still.problem.board_corners
    fits = (BundleAdjustment(corners, each, np.full_like(each, 0.1)) for each in seen)
    sure, unsure = (fit.solve(rig, poses.select(views)) for fit in fits)
    between = rig.blocks[-2]
    told = [np.sqrt(rig_covariance(one)[between, between][3, 3]) for one in (sure, unsure)]
    naive = np.linalg.inv(unsure.view_parts[0].sum(axis=0))[between, between][3, 3] ** 0.5
    assert told[1] > 1.5 * naive * unsure.reduced_chi > told[0]
