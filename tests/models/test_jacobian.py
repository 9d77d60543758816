"""Image Jacobians: finite differences of the projection, and the article's own form."""

import numpy as np

from tests.heads import MOVING, head_of
from tests.naming import named


def depths(head, q, points):
    """(..., 2) z of points of N in both cameras."""
    to_camera = np.linalg.inv(head.camera_poses(q))
    homogeneous = np.append(points, np.ones((*points.shape[:-1], 1)), axis=-1)
    return (to_camera @ homogeneous[..., None, :, None])[..., 2, 0]


def test_equals_finite_differences_of_the_projection(head, random_poses, rng):
    for own in (head, *map(head_of, MOVING)):
        q = 0.6 * random_poses(own, 200)
        towards = own.camera_poses(q)[:, :, :3, 2].mean(axis=1)
        points = towards * rng.uniform(0.5, 2.5, (200, 1)) + rng.normal(0.0, 0.03, (200, 3))
        visible = (depths(own, q, points) > 0.2).all(axis=-1)
        assert visible.mean() > 0.5
        q, points = q[visible], points[visible]
        jacobian = own.image_jacobian(q, own.project(q, points, False), depths(own, q, points))
        assert not jacobian[:, 0, :, 5:].any()  # an eye does not see the other's joints
        assert not jacobian[:, 1, :, 3:5].any()
        in_frame_0 = np.append(points, np.ones((len(q), 1)), axis=1)[..., None]
        in_frame_0 = own.base_pose(q) @ in_frame_0

        def project_resting(angles, own=own, in_frame_0=in_frame_0):
            moved = np.linalg.inv(own.base_pose(angles)) @ in_frame_0
            return own.project(angles, moved[:, :3, 0], distorted=False)

        # central differences of fourth order: truncation and rounding stay below 1e-8 relative
        step = 1e-3
        for joint, turn in enumerate(step * np.eye(7)):
            near = project_resting(q + turn) - project_resting(q - turn)
            far = project_resting(q + 2 * turn) - project_resting(q - 2 * turn)
            slope = (8.0 * near - far) / (12.0 * step)
            scale = np.abs(jacobian).max(axis=(-3, -2, -1))[:, None, None]
            with named(own.name, joint):
                assert np.abs((slope - jacobian[..., joint]) / scale).max() < 1e-7
