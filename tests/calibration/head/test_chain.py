"""Pixels through a moving head, and their derivatives."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import vergence
from tests.calibration.rigs import differences
from vergence.calibration.adjustment import BoardPoses
from vergence.calibration.head.adjust import ParametricHead, board_points_and_offsets
from vergence.eval.trials.twin_errors import TWIN_SPREADS

FRAMES = 4


def case(name):
    """A head that differs from its model, some postures, and a board in front of it."""
    about = vergence.load_head(name)
    rng = np.random.default_rng(3)
    values = about.perturbed(rng, TWIN_SPREADS).parameters(about).values
    own = about.actuation
    moves = own.upper > own.lower
    q = own.joints_of(own.actuators_of(about.rest()) + rng.uniform(-0.2, 0.2, (FRAMES, 7)) * moves)
    T = about.base_pose(about.rest())
    turn = T[:3, :3] @ Rotation.from_rotvec([0.1, 0.2, 0.1]).as_matrix()
    corners = np.column_stack([rng.uniform(-0.1, 0.1, (5, 2)), np.zeros(5)])
    boards = BoardPoses(turn[None], (T[:3, :3] @ [0.0, 0.0, 1.0] + T[:3, 3])[None])
    return about, values, q, corners, boards


def pixels(about, values, q, corners, boards):
    """(f, n, 2, 2) by the head's own kernels."""
    points, _ = board_points_and_offsets(corners, boards, np.zeros(len(q), dtype=int))
    T_0_N = about.base_pose(q)
    inside = np.einsum("fji,fnj->fni", T_0_N[:, :3, :3], points - T_0_N[:, None, :3, 3])
    return about.with_parameters(values).project(q[:, None], inside)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "eye"), [("physical", 0), ("icub", 1)])
def test_pixels_and_derivatives_are_those_of_the_head(name, eye):
    about, values, q, corners, boards = case(name)
    chain = ParametricHead(about, values)
    points, turned = board_points_and_offsets(corners, boards, np.zeros(len(q), dtype=int))
    seen = chain.project_board(eye, q, points, turned)

    def at(values, q, boards):
        return pixels(about, values, q, corners, boards)[:, :, eye]

    np.testing.assert_allclose(seen.pixels, at(values, q, boards), atol=1e-9)
    by_head = np.zeros((*seen.pixels.shape, len(values)))
    by_head[..., chain.eye_parameter_indices[eye]] = seen.head_jacobian

    there = np.array([bool(joint) for joint in about.joints])
    joints = np.eye(7)[there]
    for exact, moved in (
        (by_head, lambda step: (values + step, q, boards)),
        (seen.joint_jacobian[..., there], lambda step: (values, q + step @ joints, boards)),
        (seen.board_jacobian, lambda step: (values, q, boards.moved(step[None]))),
    ):
        expected = differences(lambda step, moved=moved: at(*moved(step)), exact.shape[-1])
        scale = 1.0 + np.abs(expected).max(axis=(0, 1, 2))
        assert (np.abs(exact - expected).max(axis=(0, 1, 2)) < 1e-6 * scale).all()
