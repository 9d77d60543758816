"""Trials with one imperfection at one value, against the same trials untouched."""

import dataclasses
from math import inf, nan

import numpy as np
import pytest

from tests.eval.trials.toys import PERIOD_S, STEP, InTwoTurns, KnowsTheWay, ideal_head
from vergence import make_controller
from vergence.eval.margins.measure import (
    MarginMeasurement,
    MarginPoint,
    noise_widened_band_px,
    with_imperfection,
)
from vergence.eval.margins.ranges import IMPERFECTION_RANGES, search_interval
from vergence.eval.trials.run import run_trials
from vergence.eval.trials.scenarios import Scenario, load_scenario

WORKSPACE = load_scenario("workspace")
KNOWN = Scenario(name="known", description="a step", target=STEP.target, duration_s=0.5)


def measured(controller, name: str, value: float, scenario: Scenario = KNOWN) -> MarginPoint:
    head = ideal_head()

    def run(scenario: Scenario):
        return run_trials(controller, scenario, episodes=10, head=head)

    return MarginMeasurement(run, scenario, name)(value)


@pytest.mark.slow
def test_at_the_expected_value_nothing_has_changed():
    scenario = dataclasses.replace(WORKSPACE, duration_s=0.1)
    head = scenario.model()
    controller = make_controller("ibvs", head)
    untouched = run_trials(controller, scenario, episodes=3)
    for name in IMPERFECTION_RANGES:
        expected = search_interval(name, scenario, head).expected
        trials = run_trials(controller, with_imperfection(scenario, name, expected), episodes=3)
        np.testing.assert_array_equal(trials.error, untouched.error, err_msg=name)


def test_all_else_stays_as_the_trial_draws_it():
    scenario = dataclasses.replace(load_scenario("hardware"), duration_s=0.05)
    controller = make_controller("ibvs", scenario.model())
    one, other = (
        run_trials(controller, each, episodes=5)
        for each in (scenario, with_imperfection(scenario, "latency_s", 0.2))
    )
    np.testing.assert_array_equal(one.error[0], other.error[0])
    for name, values in one.conditions.items():
        if name == "latency_s":
            assert np.ptp(values) > 0.0
            assert set(other.conditions[name]) == {0.2}
        else:
            np.testing.assert_array_equal(values, other.conditions[name])


def test_a_margin_ends_where_one_in_a_hundred_fails_or_the_median_has_doubled():
    def point(trials: int, settled: int) -> MarginPoint:
        return MarginPoint(0.0, 1.0, trials, settled, 0.2, 0.2)

    assert point(200, 198).settles
    assert not point(200, 197).settles
    assert point(99, 99).settles
    assert not point(99, 98).settles
    assert not point(0, 0).settles
    for median_s, keeps in {0.39: True, 0.4: False, inf: False}.items():
        assert MarginPoint(0.0, 1.0, 10, 10, median_s, 0.2).median_not_doubled is keeps


def test_what_never_settled_untouched_does_not_count():
    point = measured(KnowsTheWay(20, never=(2, 7)), "command_latency_s", 0.02)
    assert (point.trials, point.settled) == (8, 8)
    assert point.settles


def test_what_no_longer_settles_never_does():
    point = measured(KnowsTheWay(20), "speed_gain", 1.5)
    assert (point.trials, point.settled) == (10, 0)
    assert point.median_s == inf
    assert not point.settles
    assert not point.median_not_doubled


def test_where_nothing_settles_untouched_nothing_is_good():
    point = measured(KnowsTheWay(20, never=tuple(range(10))), "command_latency_s", 0.02)
    assert point.trials == 0
    assert np.isnan([point.median_s, point.untouched_median_s]).all()
    assert not point.settles
    assert not point.median_not_doubled
    assert not MarginPoint(0.0, 1.0, 0, 0, nan, nan).median_not_doubled


def test_a_late_command_adds_to_the_settling_time():
    point = measured(KnowsTheWay(20), "command_latency_s", 3 * PERIOD_S)
    assert point.untouched_median_s == pytest.approx(21 * PERIOD_S)
    assert point.median_s == pytest.approx(24 * PERIOD_S)


def test_noise_alone_widens_the_band_to_three_deviations_for_both_sides_of_the_comparison():
    assert noise_widened_band_px(KNOWN, "detection_noise_px", 0.2) == 1.0
    assert noise_widened_band_px(KNOWN, "detection_noise_px", 1.0) == 3.0
    # within 1.5 px after 21 periods, within 1 px after 31
    near = InTwoTurns(20, 30, 1.5)
    quiet = measured(near, "detection_noise_px", 0.2)
    noisy = measured(near, "detection_noise_px", 1.0)
    assert quiet.untouched_median_s == quiet.median_s == pytest.approx(31 * PERIOD_S)
    assert noisy.band_px == 3.0
    assert noisy.untouched_median_s == noisy.median_s == pytest.approx(21 * PERIOD_S)
    bands = {
        name: noise_widened_band_px(KNOWN, name, one.highest)
        for name, one in IMPERFECTION_RANGES.items()
    }
    del bands["detection_noise_px"]
    assert bands == dict.fromkeys(bands, KNOWN.band_px)


def test_what_begins_later_has_as_much_time_left():
    assert with_imperfection(KNOWN, "onset_s", 0.3).duration_s == pytest.approx(0.8)
    hardware = load_scenario("hardware")
    assert with_imperfection(hardware, "onset_s", 0.3).duration_s == hardware.duration_s
    assert with_imperfection(KNOWN, "latency_s", 0.3).duration_s == KNOWN.duration_s
