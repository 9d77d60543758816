"""Poses: the article's check values, and an implementation by others."""

import numpy as np
import pytest

from tests.naming import named
from vergence.models import ModelErrors

# Axes of N in frame 0 with the neck at rest, and the cameras' places in N (spec).
T_0_N_REST = np.array([[-1, 0, 0, -0.011], [0, 0, -1, -0.06427], [0, -1, 0, 0], [0, 0, 0, 1.0]])
CAMERAS_REST = np.array([[-0.04480, -0.03033, 0.01380], [0.04720, -0.03033, 0.01380]])
X, Y, Z = np.eye(3)


def assert_same_poses(actual, expected):
    """Within 1e-9 m and 1e-9 rad, which is far above rounding and far below any encoder."""
    difference = np.swapaxes(actual[..., :3, :3], -1, -2) @ expected[..., :3, :3] - np.eye(3)
    angle = np.linalg.norm(difference, axis=(-2, -1)) / np.sqrt(2.0)
    distance = np.linalg.norm(actual[..., :3, 3] - expected[..., :3, 3], axis=-1)
    assert angle.max() < 1e-9
    assert distance.max() < 1e-9


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

    assert_same_poses(head.base_pose(q), chain([1, 2, 3], q[:, :3]) @ T_3_N)
    for eye, frames in enumerate(([4, 5, 6], [7, 8, 9])):
        angles = np.hstack([q[:, 3 + 2 * eye : 5 + 2 * eye], fixed])
        expected = T_3_N @ chain(frames, angles) @ head.head_eye[eye]
        assert_same_poses(head.camera_poses(q)[:, eye], expected)


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
