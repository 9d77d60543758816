"""Image Jacobians: finite differences of the projection, and the article's own form."""

import numpy as np
import pytest


def depths(head, q, points):
    """(..., 2) z of points of N in both cameras."""
    to_camera = np.linalg.inv(head.camera_poses(q))
    homogeneous = np.append(points, np.ones((*points.shape[:-1], 1)), axis=-1)
    return (to_camera @ homogeneous[..., None, :, None])[..., 2, 0]


@pytest.fixture
def scene(random_poses, rng):
    """Draw poses with a point before both eyes of each, (n, 7) rad and (n, 3) m in N."""

    def draw(head, count=200):
        q = 0.6 * random_poses(head, count)
        towards = head.camera_poses(q)[:, :, :3, 2].mean(axis=1)
        points = towards * rng.uniform(0.5, 2.5, (count, 1)) + rng.normal(0.0, 0.03, (count, 3))
        visible = (depths(head, q, points) > 0.2).all(axis=-1)
        assert visible.mean() > 0.5
        return q[visible], points[visible]

    return draw


def test_equals_finite_differences_of_the_projection(head, scene):
    q, points = scene(head)
    pixels = head.project(q, points, distorted=False)
    jacobian = head.image_jacobian(q, pixels, depths(head, q, points))
    in_frame_0 = np.append(points, np.ones((len(q), 1)), axis=1)[..., None]
    in_frame_0 = head.base_pose(q) @ in_frame_0

    def project_resting(angles):
        moved = np.linalg.inv(head.base_pose(angles)) @ in_frame_0
        return head.project(angles, moved[:, :3, 0], distorted=False)

    # central differences of fourth order: both truncation and rounding stay below 1e-8 relative
    step = 1e-3
    for joint in range(7):
        turn = step * np.eye(7)[joint]
        near = project_resting(q + turn) - project_resting(q - turn)
        far = project_resting(q + 2 * turn) - project_resting(q - 2 * turn)
        slope = (8.0 * near - far) / (12.0 * step)
        scale = np.abs(jacobian).max(axis=(-3, -2, -1))[:, None, None]
        assert np.abs((slope - jacobian[..., joint]) / scale).max() < 1e-6


def test_an_eye_does_not_see_the_others_joints(head, scene):
    q, points = scene(head, 20)
    jacobian = head.image_jacobian(q, head.project(q, points, False), depths(head, q, points))
    assert not jacobian[:, 0, :, 5:].any()
    assert not jacobian[:, 1, :, 3:5].any()
