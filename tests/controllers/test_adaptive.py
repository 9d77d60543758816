"""ViSP's adaptive gain: its curve, and the law with it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.controllers.loops import settle_time, true_errors
from tests.naming import named
from vergence import load_head, make_controller
from vergence.envs.task import GazeTask
from vergence.errors import ConfigurationError

HEAD = load_head("simulated")
FOCAL = HEAD.cameras.focal


def gain_at(x: float, **options: float) -> float:
    """The left eye's gain where the larger of its two normalised errors is x."""
    error = np.array([[x, -0.3 * x], [0.0, 0.0]]) * FOCAL
    gains = make_controller("adaptive", head=HEAD, **options).gains(error)
    assert gains[0, 0] == gains[0, 1]
    return float(gains[0, 0])


LAW = {"lambda_zero": 6.0, "lambda_inf": 2.0, "slope_zero": 50.0}


def test_the_gain_has_its_two_ends_and_its_slope() -> None:
    assert gain_at(0.0, **LAW) == 6.0
    assert gain_at(5.0, **LAW) == pytest.approx(2.0)
    assert (gain_at(1e-7, **LAW) - 6.0) / 1e-7 == pytest.approx(-50.0, rel=1e-5)


@given(x=st.floats(0.0, 1.0))
def test_the_gain_is_visps(x) -> None:
    expected = (6.0 - 2.0) * np.exp(-50.0 * x / (6.0 - 2.0)) + 2.0
    assert gain_at(-x, **LAW) == pytest.approx(expected)


@given(a=st.floats(0.0, 1.0), b=st.floats(0.0, 1.0))
def test_the_gain_falls_with_the_error_or_rises_where_it_is_told_to(a, b) -> None:
    a, b = sorted((a, b))
    assert gain_at(a, **LAW) >= gain_at(b, **LAW)
    rising = {"lambda_zero": 2.0, "lambda_inf": 6.0, "slope_zero": 50.0}
    assert 2.0 <= gain_at(a, **rising) <= gain_at(b, **rising) <= 6.0


@given(x=st.floats(0.0, 1.0), slope=st.floats(0.0, 500.0))
def test_equal_ends_are_a_fixed_gain(x, slope) -> None:
    assert gain_at(x, lambda_zero=3.0, lambda_inf=3.0, slope_zero=slope) == 3.0


def test_each_eye_has_its_own_gain_and_an_unseen_target_the_far_one() -> None:
    error = np.array([[0.1, 0.0], [np.nan, np.nan]]) * FOCAL
    gains = make_controller("adaptive", head=HEAD, **LAW).gains(error)
    assert gains[0, 0] == gain_at(0.1, **LAW)
    assert gains[1, 0] == 2.0


def test_with_equal_ends_it_is_the_fixed_gain_law() -> None:
    rng = np.random.default_rng(0)
    q = HEAD.fixate(np.array([0.0, -0.1, 1.0]))
    errors = rng.uniform(-200, 200, (50, 2, 2))
    adaptive = make_controller("adaptive", head=HEAD, lambda_zero=3.0, lambda_inf=3.0)
    fixed = make_controller("ibvs", head=HEAD, gain=3.0)
    assert np.array_equal(adaptive.command(q, errors), fixed.command(q, errors))


def test_it_settles_random_targets_no_later_than_the_articles_law() -> None:
    times = []
    for name in ("ibvs", "adaptive"):
        task = GazeTask(20, head=HEAD, plant="kinematic")
        errors = true_errors(task, make_controller(name, head=HEAD, layout=task.layout), 2.0)
        each = [settle_time(errors[:, i : i + 1], 1 / 120) for i in range(20)]
        times.append(float(np.median(each)))
    assert times[1] < times[0]


def test_options_that_cannot_be_are_refused_by_name() -> None:
    for options, message in [
        ({"lambda_zero": -1.0}, "lambda_zero: expected a number of at least 0, got -1.0"),
        ({"lambda_inf": np.nan}, "lambda_inf: expected a finite number"),
        ({"slope_zero": np.inf}, "slope_zero: expected a finite number"),
        ({"gain": 4.0}, "controller adaptive: .*gain"),
    ]:
        with named(options, message), pytest.raises(ConfigurationError, match=message):
            make_controller("adaptive", head=HEAD, **options)
