"""Image Jacobians: finite differences of the projection, and the article's own form."""

import numpy as np
import pytest

from vergence.models.links import T_3_N


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


def article_jacobian(head, q, pixels, depth, eye):
    """J_image J_joint of Eqs. 3 to 6 for one eye's tilt and pan, written out, (2, 2)."""
    (fu, fv), (u0, v0) = head.cameras.focal[eye], head.cameras.principal[eye]
    x, y = (pixels[0] - u0) / fu, (pixels[1] - v0) / fv
    interaction = np.array(
        [
            [-1 / depth, 0, x / depth, x * y, -(1 + x**2), y],
            [0, -1 / depth, y / depth, 1 + y**2, -x * y, -x],
        ]
    )
    camera = head.camera_poses(q)[eye]
    pose, columns = T_3_N, []
    for frame, joint in ((4 + 3 * eye, 3 + 2 * eye), (5 + 3 * eye, 4 + 2 * eye)):
        before, after = head.links.transforms(frame)
        turn = np.eye(4)
        c, s = np.cos(q[joint]), np.sin(q[joint])
        turn[:2, :2] = [[c, -s], [s, c]]
        pose = pose @ before @ turn @ after
        z, o = pose[:3, 2], pose[:3, 3]
        columns.append(np.concatenate([np.cross(z, camera[:3, 3] - o), z]))
    j_theta = np.stack(columns, axis=1)
    to_camera = np.kron(np.eye(2), camera[:3, :3].T)
    return np.diag([fu, fv]) @ interaction @ to_camera @ j_theta


def test_equals_the_articles_interaction_matrix(head, scene):
    q, points = scene(head, 20)
    pixels = head.project(q, points, distorted=False)
    depth = depths(head, q, points)
    jacobian = head.image_jacobian(q, pixels, depth)
    for i in range(len(q)):
        for eye in range(2):
            own = jacobian[i, eye, :, 3 + 2 * eye : 5 + 2 * eye]
            expected = article_jacobian(head, q[i], pixels[i, eye], depth[i, eye], eye)
            np.testing.assert_allclose(own, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_an_eye_does_not_see_the_others_joints(head, scene):
    q, points = scene(head, 20)
    jacobian = head.image_jacobian(q, head.project(q, points, False), depths(head, q, points))
    assert not jacobian[:, 0, :, 5:].any()
    assert not jacobian[:, 1, :, 3:5].any()


def test_population_equals_finite_differences(physical, errors, rng):
    heads = physical.perturbed(rng, errors, size=50)
    point, q, step = np.array([0.05, -0.08, 1.2]), np.full(7, 0.05), 1e-3
    pixels = heads.project(q, point, distorted=False)
    points = np.broadcast_to(point, (50, 3))
    jacobian = heads.image_jacobian(q, pixels, depths(heads, q, points))
    for joint in range(3, 7):
        turn = step * np.eye(7)[joint]
        near = heads.project(q + turn, point, False) - heads.project(q - turn, point, False)
        far = heads.project(q + 2 * turn, point, False) - heads.project(q - 2 * turn, point, False)
        slope = (8.0 * near - far) / (12.0 * step)
        assert np.abs(slope - jacobian[..., joint]).max() < 1e-6 * np.abs(jacobian).max()
