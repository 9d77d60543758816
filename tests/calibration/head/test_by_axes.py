"""A head by its axes is the same head, and goes into a file and back."""

import numpy as np
import pytest

import vergence
from vergence.calibration.head.terms import dh_to_joint_axes
from vergence.models.head_file import head_to_toml, parse_head


@pytest.fixture
def head():
    return vergence.load_head("physical")


def test_it_looks_where_the_head_looks(head):
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (20, 7))
    found = dh_to_joint_axes(head)
    np.testing.assert_allclose(found.camera_poses(q), head.camera_poses(q), atol=1e-12)
    np.testing.assert_allclose(found.base_pose(q), head.base_pose(q), atol=1e-12)


def test_what_moves_it_and_what_it_cannot_reach_stay(head):
    found = dh_to_joint_axes(head)
    assert found.joints == head.joints
    assert found.actuation.direct
    np.testing.assert_array_equal(found.actuation.lower, head.actuation.lower)
    np.testing.assert_array_equal(found.actuation.angle_step, head.actuation.angle_step)


def test_it_goes_into_a_file_and_back(head):
    found = dh_to_joint_axes(head)
    assert parse_head(head_to_toml(found)) == found


def test_a_head_by_its_axes_already_stays_as_it_is():
    head = vergence.load_head("icub")
    assert dh_to_joint_axes(head) is head


def test_its_tilts_can_be_turned_about_the_vertical(head):
    found = dh_to_joint_axes(head)
    names = found.parameters().names
    values = found.parameters().values.copy()
    values[names.index("left.1.ry")] += 0.01
    q = np.zeros(7)
    moved = found.with_parameters(values).camera_poses(q)[0]
    turn = moved[:3, :3] @ head.camera_poses(q)[0, :3, :3].T
    assert abs(turn[2, 0]) == pytest.approx(np.sin(0.01))
