"""Heads of any joints: chains, frames, and what belongs to both eyes."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.heads import CENTRE, IMAGE, LOOP, TEXTS, eyes, head_of, joint
from tests.models.lenses import wide
from tests.naming import named
from vergence.models import ModelErrors, load_head, parse_head
from vergence.models.perturbation import DEVIATES, perturb_by_deviates

OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""A camera's axes in a robot's frame, x forward, y left, z up."""


def chain(*steps):
    """The product of transforms, each an origin, a rotation vector, or a matrix."""
    pose = np.eye(4)
    for origin, turn in steps:
        step = np.eye(4)
        step[:3, :3], step[:3, 3] = Rotation.from_rotvec(turn).as_matrix(), origin
        pose = pose @ step
    return pose


def test_a_chain_is_the_product_of_its_joints_turns(rng):
    q = rng.uniform(-0.8, 0.8, 7)
    head = head_of("tied")
    origin = np.array([0.0, -0.15, 0.05])  # midway between the eyes at zero
    neck = chain(
        (CENTRE, q[0] * np.array([1.0, 0, 0])), (CENTRE, q[1] * np.array([0, 0, 1.0])),
        ((0, -0.1, 0), q[2] * np.array([0, 1.0, 0])),
    )  # fmt: skip
    frame = chain((origin - [0, -0.1, 0], np.zeros(3)))
    np.testing.assert_allclose(head.base_pose(q), neck @ frame, atol=1e-15)
    q[5] = q[3]  # one tilt carries both eyes
    for eye, side in enumerate((-1, 1)):
        own = chain(
            ((0, -0.05, 0.05), q[3] * np.array([1.0, 0, 0])),
            ((0.034 * side, 0, 0), q[4 + 2 * eye] * np.array([0, 1.0, 0])),
        )
        found = head.camera_poses(q)[eye]
        np.testing.assert_allclose(found, np.linalg.inv(frame) @ own, atol=1e-15)


def test_frame_n_is_midway_between_the_eyes_and_looks_as_they_do():
    # the base is a robot's: x forward, y left, z up; the eyes are turned in by 5 degrees
    text = 'name = "robot"\n' + IMAGE + eyes((0.02, 0.1, 0.3), (0.02, -0.1, 0.3)) + LOOP
    for eye, angle in enumerate((-0.1, 0.1)):
        turn = Rotation.from_rotvec([0, 0, angle]).as_matrix() @ OPTICAL
        at = f"position_m = [0.02, {0.1 - 0.2 * eye}, 0.3]\n"
        assert at in text
        text = text.replace(at, f"{at}rotation = {turn.tolist()}\n")
    poses = parse_head(text).camera_poses(np.zeros(7))
    np.testing.assert_allclose(poses[:, :3, 3], [[-0.1, 0, 0], [0.1, 0, 0]], atol=1e-15)
    np.testing.assert_allclose(poses[:, :3, 2].sum(axis=0)[:2], 0.0, atol=1e-15)
    assert poses[0, 0, 2] > 0.0 > poses[1, 0, 2]  # both look inwards


def test_a_row_of_dh_numbers_is_an_axis_like_any_other(rng):
    alpha, a, d, offset = -1.2, 0.02, -0.03, 0.7
    row = (
        f'[[joints]]\nname = "pan"\npart = "both"\nalpha_rad = {alpha}\na_m = {a}\nd_m = {d}\n'
        f"offset_rad = {offset}\nlower_rad = -1.0\nupper_rad = 1.0\nvelocity_rad_s = 5.0\n"
        "acceleration_rad_s2 = 80.0\n"
    )
    frame = "[frame]\norigin_m = [0.0, 0.0, 0.0]\n"
    tilts = joint("lt", "left", (0, 0.03, 0), (0, 1, 0))
    tilts += joint("rt", "right", (0, -0.03, 0), (0, 1, 0))
    # the eyes look along x of their links
    cameras = eyes().replace("position_m", f"rotation = {OPTICAL.tolist()}\nposition_m")
    head = parse_head('name = "dh"\n' + frame + row + tilts + IMAGE + cameras + LOOP)
    q = rng.uniform(-0.5, 0.5)
    expected = chain(
        (CENTRE, (alpha, 0, 0)), ((a, 0, 0), (0, 0, q + offset)), ((0, 0, d), np.zeros(3))
    ) @ chain(((0, 0.03, 0), np.zeros(3)))
    found = head.camera_poses([0, 0, 0, q, 0, q, 0])[0]
    np.testing.assert_allclose(found[:3, 3], expected[:3, 3], atol=1e-15)
    np.testing.assert_allclose(found[:3, :3], expected[:3, :3] @ OPTICAL, atol=1e-15)


def test_a_joint_that_is_missing_turns_nothing_and_heads_of_a_population_are_stacked(rng):
    for head in (*map(head_of, TEXTS), wide("fisheye", "rational")):
        missing = np.array([not joint for joint in head.joints])
        for poses in (head.camera_poses, head.base_pose):
            np.testing.assert_array_equal(poses(0.7 * missing), poses(np.zeros(7)))
        for ends in (head.limits.lower, head.limits.upper):
            assert not ends[missing].any()
        heads = head.perturbed(rng, ModelErrors(head_eye_rad=0.01, link_m=1e-3), size=3)
        stacked = type(head).stack([heads[i] for i in range(3)])
        np.testing.assert_array_equal(stacked.packed, heads.packed)
        assert stacked.cameras.lens == head.cameras.lens


def test_an_axis_that_both_eyes_share_is_perturbed_once_and_a_common_tilt_alike(rng):
    head = head_of("tied")
    errors = ModelErrors(link_m=1e-3, coaxiality_rad=0.01, joint_offset_rad=0.02)
    heads = head.perturbed(rng, errors, size=50)
    first = heads.links.pose[:, 3]  # one for both
    assert heads.links.pose.shape == (50, 6, 4, 4)
    assert np.abs(first - head.links.pose[3]).max() > 1e-3
    # the tilt axis in N is the same line for the left eye and for the right
    axes = [heads.packed[:, 4 * 12 + 36 * eye : 4 * 12 + 36 * eye + 12] for eye in range(2)]
    np.testing.assert_array_equal(axes[0], axes[1])
    heads = map(load_head, ("simulated", "turrets"))
    for head in (*heads, *map(head_of, ("tied", "panfirst", "common"))):
        with named(head.name):
            errors, rest = ModelErrors(common_tilt_rad=0.02), np.zeros(7)
            drawn = head.perturbed(np.random.default_rng(3), errors, size=40)
            # how far each axis looks down, from where the model's does
            before = head.camera_poses(rest)[:, 1, 2]
            y = drawn.camera_poses(rest)[:, :, 1, 2] - before
            np.testing.assert_allclose(y[:, 0], y[:, 1], atol=1e-12)
            assert np.std(y[:, 0]) == pytest.approx(0.02, rel=0.5)
            lowered = perturb_by_deviates(head.geometry, errors, np.eye(DEVIATES)[-1])
            down = head.replace(**lowered._asdict()).camera_poses(rest)[:, 1, 2] - before
            np.testing.assert_allclose(down, 0.02, rtol=1e-3)
