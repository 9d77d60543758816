"""Projection and its inverse: OpenCV's lens model, pixel centres at integers."""

import numpy as np

REST = np.zeros(7)


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
