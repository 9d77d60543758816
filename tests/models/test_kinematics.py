"""Poses and image Jacobians: the article's values, others' implementation, finite differences."""

from functools import partial

import numpy as np
import pytest

from tests.heads import MOVING, head_of
from tests.naming import named
from vergence.models import ModelErrors

# Axes of N in frame 0 with the neck at rest, and the cameras' places in N (spec).
T_0_N_REST = np.array([[-1, 0, 0, -0.011], [0, 0, -1, -0.06427], [0, -1, 0, 0], [0, 0, 0, 1.0]])
CAMERAS_REST = np.array([[-0.04480, -0.03033, 0.01380], [0.04720, -0.03033, 0.01380]])
X, Y, Z = np.eye(3)


def test_at_rest_n_and_the_cameras_are_where_the_article_has_them(simulated, physical):
    for head in (simulated, physical):
        with named(head.name):
            np.testing.assert_allclose(head.base_pose(np.zeros(7)), T_0_N_REST, atol=1e-12)
            poses = head.camera_poses(np.zeros(7))
            np.testing.assert_allclose(poses[:, :3, 3], CAMERAS_REST, atol=1e-12)
            np.testing.assert_allclose(poses[:, :3, :3], [np.eye(3)] * 2, atol=1e-12)


def test_positive_turns_have_the_articles_directions(simulated):
    """N has x right, y down, z forward as the head sees it."""
    zero = np.zeros(7)
    rest = simulated.base_pose(zero)[:3, :3]
    for what, joint, axis, towards in (
        ("yaw turns left", 0, Z, -X), ("roll lowers the right ear", 1, X, Y),
        ("pitch looks up", 2, Z, -Y), ("left tilt looks down", 3, Z, Y),
        ("left pan looks left", 4, Z, -X), ("right tilt looks up", 5, Z, -Y),
        ("right pan looks left", 6, Z, -X),
    ):  # fmt: skip
        with named(what):
            turned, eye = 0.1 * np.eye(7)[joint], (joint - 3) // 2
            poses, before = simulated.camera_poses([turned, zero])
            if joint < 3:
                moved = rest.T @ simulated.base_pose(turned)[:3, :3]
            else:
                moved = poses[eye, :3, :3]
                np.testing.assert_array_equal(poses[1 - eye], before[1 - eye])
            assert moved @ axis @ towards == pytest.approx(np.sin(0.1), abs=1e-12)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.nightly
def test_poses_agree_with_the_robotics_toolbox(head, random_poses):
    toolbox = pytest.importorskip("roboticstoolbox")
    own = head.links
    rows = zip(own.a, own.alpha, own.d, own.offset, strict=True)
    links = [toolbox.RevoluteMDH(a=a, alpha=b, d=d, offset=c) for a, b, d, c in rows]
    # the rotation from frame 3 to N, from the words of the article
    T_3_N = np.eye(4)[[2, 1, 0, 3]] * [1, -1, 1, 1]
    q = random_poses(head, 1000)
    fixed = np.zeros((1000, 1))

    def chain(frames, angles):
        robot = toolbox.DHRobot([links[frame - 1] for frame in frames])
        return np.array([pose.A for pose in robot.fkine(angles)])

    # 0.9e-9 m and rad: far above rounding and far below any encoder
    close = partial(np.testing.assert_allclose, rtol=0.0, atol=4e-10)
    close(head.base_pose(q), chain([1, 2, 3], q[:, :3]) @ T_3_N)
    for eye, frames in enumerate(([4, 5, 6], [7, 8, 9])):
        angles = np.hstack([q[:, 3 + 2 * eye : 5 + 2 * eye], fixed])
        close(head.camera_poses(q)[:, eye], T_3_N @ chain(frames, angles) @ head.head_eye[eye])


def test_populations_and_batches_equal_a_loop_bit_for_bit(physical, rng, errors, random_poses):
    population = physical.perturbed(rng, errors, size=(5, 1))
    poses = random_poses(population, 3)
    points = rng.uniform([-0.3, -0.3, 0.5], [0.3, 0.3, 2.0], (3, 3))
    for name, compute in {
        "base_pose": lambda head, q, p: head.base_pose(q),
        "camera_poses": lambda head, q, p: head.camera_poses(q),
        "link_poses": lambda head, q, p: head.link_poses(q),
        "project": lambda head, q, p: head.project(q, p),
        "undistort": lambda head, q, p: head.undistort(head.project(q, p)),
        "image_jacobian": lambda head, q, p: head.image_jacobian(
            q, head.project(q, p, False), p[..., 1:]
        ),
        "fixate": lambda head, q, p: head.fixate(p, neck=q[..., :3]),
    }.items():
        together = compute(population, poses, points)
        assert together.shape[:2] == (5, 3)
        for i, j in np.ndindex(5, 3):
            with named(name, i, j):
                alone = compute(population[i, 0], poses[j], points[j])
                np.testing.assert_array_equal(together[i, j], alone)


def test_head_eye_transforms_lead_from_links_to_cameras(head, physical, random_poses, rng):
    q = random_poses(head, 200)
    seen = head.link_poses(q) @ head.head_eye
    np.testing.assert_allclose(seen, head.camera_poses(q), rtol=0, atol=1e-14)
    drawn = physical.perturbed(rng, ModelErrors(head_eye_rad=0.1, head_eye_m=0.01))
    np.testing.assert_allclose(drawn.link_poses(q), physical.link_poses(q), rtol=0, atol=1e-14)


def depths(head, q, points):
    """(..., 2) z of points of N in both cameras."""
    poses = head.camera_poses(q)
    from_cameras = points[..., None, :] - poses[..., :3, 3]
    return (from_cameras * poses[..., :3, 2]).sum(axis=-1)


def test_an_image_jacobian_equals_finite_differences_of_the_projection(head, random_poses, rng):
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
