"""Gains that vary: ViSP's adaptive gain with its curve, and gains from outside."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.controllers.loops import begin, settle_time, true_errors
from tests.heads import head_of
from tests.naming import named
from vergence import load_head, make_controller
from vergence.controllers.adaptive import (
    GAIN_LIMIT,
    TILT_FIRST_GAIN_NAMES,
    gain_names_of_head,
    gains_from_action,
)
from vergence.controllers.ibvs import ibvs_velocities
from vergence.envs.task import GazeTask

HEAD = load_head("simulated")
FOCAL = HEAD.cameras.focal


def gain_at(x: float, **options: float) -> float:
    """The left eye's gain where the larger of its two normalised errors is x."""
    error = np.array([[x, -0.3 * x], [0.0, 0.0]]) * FOCAL
    gains = make_controller("adaptive", head=HEAD, **options).gains(error)
    assert gains[0, 0] == gains[0, 1]
    return float(gains[0, 0])


LAW = {"lambda_zero": 6.0, "lambda_inf": 2.0, "slope_zero": 50.0}


@given(x=st.floats(0.0, 1.0))
def test_the_gain_is_visps(x) -> None:
    expected = (6.0 - 2.0) * np.exp(-50.0 * x / (6.0 - 2.0)) + 2.0
    assert gain_at(-x, **LAW) == pytest.approx(expected)


def test_each_eye_has_its_own_gain_and_an_unseen_target_the_far_one() -> None:
    error = np.array([[0.1, 0.0], [np.nan, np.nan]]) * FOCAL
    gains = make_controller("adaptive", head=HEAD, **LAW).gains(error)
    assert gains[0, 0] == gain_at(0.1, **LAW)
    assert gains[1, 0] == 2.0


def test_it_settles_random_targets_no_later_than_the_articles_law() -> None:
    times = []
    for name in ("ibvs", "adaptive"):
        task = GazeTask(20, head=HEAD, plant="kinematic")
        errors = true_errors(task, make_controller(name, head=HEAD, layout=task.layout), 2.0)
        times.append(np.median(settle_time(errors, 1 / 120)))
    assert times[1] < times[0]


numbers = st.lists(st.floats(-3.0, 3.0), min_size=4, max_size=4)


@given(numbers)
def test_gains_are_never_negative_and_never_above_their_limit(action) -> None:
    gains = gains_from_action(action)
    assert gains.shape == (2, 2)
    assert ((gains >= 0.0) & (gains <= GAIN_LIMIT)).all()


def test_the_order_is_that_of_the_joints_which_answer() -> None:
    """A tilt moves v and a pan moves u."""
    assert gains_from_action([-1, 1, -1, -1])[0].tolist() == [20.0, 0.0]
    assert gains_from_action([-1, -1, 1, -1])[1].tolist() == [0.0, 20.0]
    names = gain_names_of_head(head_of("panfirst"))
    assert names == ("left_u", "left_v", "right_u", "right_v")
    assert gains_from_action([1, -1, -1, -1], names)[0].tolist() == [20.0, 0.0]
    for head in (HEAD, *map(head_of, ("tied", "mis", "common", "vergeonly"))):
        with named(head.name):
            assert gain_names_of_head(head) == TILT_FIRST_GAIN_NAMES


def seen(num: int = 50) -> GazeTask:
    task = begin(GazeTask(num, plant="kinematic"), 3)
    for _ in range(9):
        task.step(np.zeros((num, 4)))
    return task


def test_whatever_the_gains_the_image_error_shrinks() -> None:
    """A small turn along the command, with gains drawn for each eye and axis."""
    task = seen()
    truth = task.truth()
    gains = np.random.default_rng(0).uniform(0.1, 20.0, (task.num, 2, 2))
    now = task.layout.decode(task.observation)
    command = ibvs_velocities(
        task.head,
        now.positions_at_exposure,
        now.pixel_error,
        gains,
        np.nan,
        task.layout.action_limits,
    )
    q = truth.positions.copy()
    q[:, 3:] += 1e-3 * command
    before = task.head.project(truth.positions, truth.target) - task.head.cameras.principal
    after = task.head.project(q, truth.target) - task.head.cameras.principal
    assert (np.abs(after) <= np.abs(before) + 0.1).all()
    assert (np.linalg.norm(after, axis=-1) < np.linalg.norm(before, axis=-1)).all()
