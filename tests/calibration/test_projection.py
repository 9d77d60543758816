"""Projection with derivatives: the same pixels as the kernels', derivatives as differences say."""

import numpy as np
import pytest

from vergence.calibration.adjustment import project_with_jacobians
from vergence.models.camera import rays_to_pixels
from vergence.models.lens import pack_camera

LENSES = {
    "brown-conrady": [0.1, -0.2, 0.001, -0.002, 0.05],
    "rational": [0.5, 0.2, 0.001, -0.002, 0.05, 0.3, 0.1, 0.02],
    "fisheye": [0.1, -0.02, 0.01, 0.003],
}
STEP = 1e-6


@pytest.fixture
def points():
    rng = np.random.default_rng(1)
    return np.column_stack([rng.uniform(-0.4, 0.4, (30, 2)), rng.uniform(0.6, 1.0, 30)])


def test_pixels_are_those_of_the_kernels(points):
    for lens, coefficients in LENSES.items():
        values = np.array([500.0, 510.0, 320.0, 240.0, *coefficients])
        row = pack_camera((640, 480), values[:2], values[2:4], lens, values[4:])
        expected = rays_to_pixels(points[:, :2] / points[:, 2:], row)
        found = project_with_jacobians(lens, values, points).pixels
        np.testing.assert_allclose(found, expected, atol=1e-10, err_msg=lens)


@pytest.mark.parametrize("lens", LENSES)
def test_derivatives_are_those_of_small_steps(lens, points):
    values = np.array([500.0, 510.0, 320.0, 240.0, *LENSES[lens]])
    found = project_with_jacobians(lens, values, points)
    by_point, by_camera = (
        np.stack([(at(step) - at(-step)) / (2.0 * STEP) for step in STEP * np.eye(count)], axis=-1)
        for count, at in (
            (3, lambda step: project_with_jacobians(lens, values, points + step).pixels),
            (len(values), lambda step: project_with_jacobians(lens, values + step, points).pixels),
        )
    )
    np.testing.assert_allclose(found.point_jacobian, by_point, atol=1e-5)
    np.testing.assert_allclose(found.camera_jacobian, by_camera, atol=1e-5)


def test_points_behind_the_camera_have_no_pixel():
    values = np.array([500.0, 500.0, 320.0, 240.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    behind = np.array([0.0, 0.0, -1.0])
    assert np.isnan(project_with_jacobians("brown-conrady", values, behind).pixels).all()
