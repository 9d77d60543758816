"""ViSP's adaptive gain: its curve, and the law with it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.controllers.loops import settle_time, true_errors
from vergence import load_head, make_controller
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
        each = [settle_time(errors[:, i : i + 1], 1 / 120) for i in range(20)]
        times.append(float(np.median(each)))
    assert times[1] < times[0]
