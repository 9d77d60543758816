"""Double steps: two points that both eyes can see and fixate, and a second jump in between."""

import numpy as np
import pytest
from scipy.stats import spearmanr

from tests.envs.trials import assert_uniform, draw, eccentricity, inside
from tests.naming import named
from vergence import HeadModel
from vergence.envs.plant import make_plant
from vergence.envs.targets.motion import is_detectable_by_both_eyes, last_jump_time, target_position
from vergence.envs.targets.workspace import DoubleStepTarget
from vergence.errors import ConfigurationError


def turn(begin, goal):
    """(n,) the angles that the farther-turning eyes turn, rad."""
    return np.linalg.norm((goal - begin)[:, 3:].reshape(-1, 2, 2), axis=-1).max(axis=-1)


def test_both_points_keep_the_promises(head: HeadModel) -> None:
    for start in ["fixation", "rest"]:
        with named(start):
            target = DoubleStepTarget(start=start)
            rows, q = draw(head, target, 500)
            jump = last_jump_time(rows)
            first, second = target_position(rows, 0.0), target_position(rows, jump)
            goals = head.fixate(first), head.fixate(second)
            for points, goal in zip((first, second), goals, strict=True):
                assert (points[:, 2] >= 0.3).all()
                assert (points[:, 2] <= 2.5).all()
                assert (eccentricity(head, points) <= target.eccentricity + 1e-12).all()
                assert head.limits.contains(goal, target.margin).all()
                assert inside(head, q, points)
            assert inside(head, goals[0], second)
            assert (turn(q, goals[0]) >= target.shift).all()
            assert (turn(*goals) >= target.shift).all()
            assert (np.abs(q[:, 3:]).max(axis=1) > 0).all() == (start == "fixation")


def test_the_second_point_is_seen_on_the_way_to_the_first(simulated: HeadModel) -> None:
    rows, q = draw(simulated, "double-step", 500)
    goal, second = simulated.fixate(target_position(rows, 0.0)), target_position(rows, 1.0)
    for share in (0.25, 0.5, 0.75):
        pixels = simulated.project(q + share * (goal - q), second)
        seen = ((pixels >= 0) & (pixels <= simulated.cameras.size - 1)).all(axis=(-2, -1))
        assert seen.mean() > 0.99


def test_the_second_jump_comes_when_the_trial_has_drawn_it(simulated: HeadModel) -> None:
    rows, _q = draw(simulated, {"kind": "double-step", "second_after": (0.05, 0.3)}, 1000)
    jump = last_jump_time(rows)
    assert_uniform((jump - 0.05) / 0.25)
    first, second = target_position(rows, 0.0), target_position(rows, 1e3)
    assert np.array_equal(target_position(rows, np.nextafter(jump, 0.0)), first)
    assert np.array_equal(target_position(rows, jump), second)
    assert (np.linalg.norm(second - first, axis=-1) > 0.0).all()
    for point in (first, second):  # a word that both were drawn from would tie them
        for number in (point[:, 0] / point[:, 2], point[:, 1] / point[:, 2], 1.0 / point[:, 2]):
            assert abs(spearmanr(jump, number).statistic) < 0.15  # 5 deviations


def test_a_border_holds_for_both_points(simulated: HeadModel) -> None:
    rows, q = draw(simulated, {"kind": "double-step", "border": 30.0}, 200)
    for points in (target_position(rows, 0.0), target_position(rows, 1.0)):
        pixels = simulated.project(q, points)
        assert (pixels >= 30.0).all()
        assert (pixels <= simulated.cameras.size - 31.0).all()


def test_the_whole_board_is_seen_at_both_points(simulated: HeadModel) -> None:
    board = make_plant("rendered", simulated, 1, width_rad="fit").board
    rows, q = draw(simulated, "double-step", 50, board=board)
    first, second = target_position(rows, 0.0), target_position(rows, 1.0)
    goal = simulated.fixate(first)
    for begin, there, one, two in zip(q[:, 3:], goal[:, 3:], first, second, strict=True):
        assert is_detectable_by_both_eyes(simulated.packed, begin, tuple(one), 0.0, board)
        assert is_detectable_by_both_eyes(simulated.packed, begin, tuple(two), 0.0, board)
        assert is_detectable_by_both_eyes(simulated.packed, there, tuple(two), 0.0, board)


def test_a_workspace_without_a_second_point_is_refused(simulated: HeadModel) -> None:
    # all its points lie within a tenth of a degree of one another
    target = {"kind": "double-step", "depth": (1.0, 1.001), "eccentricity": 0.001, "start": "rest"}
    draw(simulated, {**target, "shift": 0.0})
    with pytest.raises(ConfigurationError, match=r"none of 1000 pairs of points of DoubleStep"):
        draw(simulated, {**target, "shift": 0.01})
