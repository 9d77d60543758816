"""Projection and its inverse: OpenCV's lens model, pixel centres at integers."""

import numpy as np

REST = np.zeros(7)


def inside(head, pixels):
    """Mask of raw pixels (..., 2, 2) that lie in the images."""
    return ((pixels >= -0.5) & (pixels <= head.cameras.size - 0.5)).all(axis=-1)


def test_a_point_on_the_axis_is_at_the_principal_point(head):
    on_axis = head.camera_poses(REST)[:, :3, 3] + 0.7 * head.camera_poses(REST)[:, :3, 2]
    pixels = head.project(REST, on_axis)
    for eye in range(2):
        np.testing.assert_allclose(pixels[eye, eye], head.cameras.principal[eye], atol=1e-9)


def test_without_distortion_the_projection_is_a_pinhole(physical):
    point = np.array([0.1, -0.1, 0.8])
    camera = np.linalg.inv(physical.camera_poses(REST)) @ [*point, 1.0]
    expected = physical.cameras.principal + physical.cameras.focal * camera[:, :2] / camera[:, 2:3]
    pixels = physical.project(REST, point, distorted=False)
    np.testing.assert_allclose(pixels, expected, atol=1e-9)


def test_behind_a_camera_there_is_no_pixel(head):
    for z in (-1.0, 0.0138):
        # 0.1 m further back, as a drawn head's cameras may look slightly aside
        assert np.isnan(head.project(REST, np.array([0.0, 0.0, z - 0.1]))).all(), z


def test_undistort_is_the_pinholes_pixel(head, rng, random_poses):
    points = rng.uniform([-0.4, -0.3, 0.6], [0.4, 0.3, 2.0], (300, 3))
    q = 0.2 * random_poses(head, 300)
    raw, ideal = head.project(q, points), head.project(q, points, distorted=False)
    seen = inside(head, raw)
    assert seen.mean() > 0.5
    assert np.abs(head.undistort(raw) - ideal)[seen].max() < 1e-9
