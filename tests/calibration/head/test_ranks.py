"""Number of observable parameters of the article's head, for recordings of several kinds.

The 44 parameters and the ranks are those of the numerical study in spec.md: 34 of the kinematics,
and focal length, principal point and two coefficients of either lens. A direction counts as
observable if its information, in units of the spreads of real heads, is more than 1e-10 of the
largest.
"""

import numpy as np
import pytest

import vergence
from vergence.calibration.head.adjust import HeadAdjustment, MeasurementWeights, ParametricHead
from vergence.calibration.head.simulated import simulate_recording
from vergence.eval.trials.twin_errors import TWIN_SPREADS
from vergence.models.parts import EYE_NAMES
from vergence.models.perturbation import standard_deviations

SEEN = 1e-10


HEAD = vergence.load_head("physical")
SPREADS = standard_deviations(HEAD.geometry, TWIN_SPREADS)


def scaled_columns():
    """(p, 44) the study's numbers in units of their spreads; both focal lengths are one."""
    names = HEAD.parameters().names
    columns = np.diag(SPREADS)
    for place, name in enumerate(names):
        if name.endswith("f_u"):
            columns[place + 1, place] = SPREADS[place + 1]
    kept = [place for place, name in enumerate(names) if SPREADS[place] and name[-3:] != "f_v"]
    assert len(kept) == 44
    return columns[:, kept]


def recorded(seed, **options):
    """(44, 44) what a recording tells of the numbers."""
    seen = simulate_recording(HEAD, HEAD, np.random.default_rng(seed), frames_per_pose=2, **options)
    problem = HeadAdjustment(HEAD, np.full(len(SPREADS), np.inf), seen.frames)
    normal = problem.linearised(problem.start(seen.boards), MeasurementWeights.of(seen.frames.seen))
    p = len(SPREADS)
    rest, across = normal.matrix[p:, p:], normal.matrix[:p, p:]
    S = scaled_columns()
    return S.T @ (normal.matrix[:p, :p] - across @ np.linalg.solve(rest, across.T)) @ S


def gaps(seed):
    """(44, 44) what the gaps between the optical axes of fixations tell of the numbers."""
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(-0.3, 0.3, (60, 2)), rng.uniform(0.4, 2.5, 60)])
    q = HEAD.fixate(points)
    chain = ParametricHead(HEAD, HEAD.parameters().values)
    T_0_N = HEAD.base_pose(np.zeros(7))
    there = (points @ T_0_N[:3, :3].T + T_0_N[:3, 3])[:, None]
    by_head, by_point = np.zeros((60, 4, len(SPREADS))), np.zeros((60, 4, 3))
    for eye in range(2):
        seen = chain.project_board(eye, q, there, there)
        own = chain.eye_parameter_indices[eye]
        by_head[:, 2 * eye : 2 * eye + 2, own] = seen.head_jacobian[:, 0]
        by_point[:, 2 * eye : 2 * eye + 2] = seen.board_jacobian[:, 0, :, 3:]
    # what is left of four pixels once the point may be anywhere
    across = np.linalg.svd(by_point)[0][:, :, 3:]
    rows = (across.transpose(0, 2, 1) @ by_head @ scaled_columns()).reshape(60, 44)
    return rows.T @ rows


def rank(matrix):
    values = np.linalg.eigvalsh(matrix)
    return int((values > SEEN * values[-1]).sum())


@pytest.mark.slow
def test_boards_tell_all_but_where_the_eyes_are_in_the_neck():
    assert rank(recorded(0, move_neck=False)) == 30


@pytest.mark.slow
def test_boards_and_a_moving_neck_tell_all_but_redundant_directions():
    assert rank(recorded(0)) == 34


def test_fixated_tags_and_a_moving_neck_tell_all_but_the_lens_far_from_the_axis():
    values = np.linalg.eigvalsh(recorded(0, target="tag:36h11:1:50", off_axis=0.0))[::-1]
    # the second coefficients of both lenses are told by what is left of 40 px off the axis alone
    assert values[31] > 1e3 * values[32]
    assert rank(np.diag(values)) in (32, 33, 34)


def test_gaps_tell_seven_numbers_and_nothing_of_a_pan():
    matrix = gaps(0)
    assert rank(matrix) == 7
    names = [n for n, s in zip(HEAD.parameters().names, SPREADS, strict=True) if s]
    pans = [[n for n in names if n[-3:] != "f_v"].index(f"{eye}.pan.offset") for eye in EYE_NAMES]
    assert np.diagonal(matrix)[pans].max() < 1e-6 * np.diagonal(matrix).max()
