"""Ranges that are searched, the search, and trials at one value against those untouched."""

import dataclasses
import itertools
from math import inf, nan

import numpy as np
import pytest

from tests.eval.trials.toys import PERIOD_S, STEP, InTwoTurns, KnowsTheWay, ideal_head
from vergence import make_controller
from vergence.envs.plants.conditions import IMPERFECTIONS, LOOP_PARTS, RANGES, is_valid_range
from vergence.eval.margins.run import (
    BISECTIONS,
    GRID_FRACTIONS,
    IMPERFECTION_RANGES,
    MarginMeasurement,
    MarginPoint,
    has_effect,
    last_holding_value,
    noise_widened_band_px,
    search_interval,
    with_imperfection,
)
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


HARDWARE = load_scenario("hardware")


def test_every_imperfection_is_searched_within_what_it_may_be():
    assert IMPERFECTION_RANGES.keys() == set(RANGES)
    for name, one in IMPERFECTION_RANGES.items():
        assert is_valid_range(name, one.lowest, one.highest), name


def test_margins_are_shown_part_by_part_of_the_loop():
    parts = [IMPERFECTIONS[name].part for name in IMPERFECTION_RANGES]
    assert parts == sorted(parts, key=LOOP_PARTS.index)


def test_what_robots_do_lies_within_what_is_searched():
    for name, low, high in (
        ("command_latency_s", 0.0, 0.025), ("feedback_latency_s", 0.0, 0.02),
        ("latency_s", 0.0, 0.2), ("frame_phase", 0.0, 1.0), ("acceleration_ratio", 0.3, 1.5),
        ("speed_gain", 0.7, 1.3), ("detection_noise_px", 0.02, 1.0), ("backlash_rad", 0.0, 0.004),
        ("outlier_probability", 0.0, 0.02), ("frame_rate_hz", 15.0, 120.0),
    ):  # fmt: skip
        found = search_interval(name, WORKSPACE, WORKSPACE.model())
        assert found.low <= low < high <= found.high, name


def test_the_search_begins_at_what_the_model_says():
    head = WORKSPACE.model()
    for name, one in IMPERFECTIONS.items():
        assert search_interval(name, WORKSPACE, head).expected == np.max(one.nominal(head))


def test_the_search_begins_within_what_a_scenario_draws():
    head = HARDWARE.model()
    for name in IMPERFECTION_RANGES:
        drawn = getattr(HARDWARE.variation, name)
        if drawn is not None:
            assert drawn[0] <= search_interval(name, HARDWARE, head).expected <= drawn[1], name
    assert search_interval("latency_s", HARDWARE, head).expected == head.timing.latency_s
    assert search_interval("dropped_frame_probability", HARDWARE, head).expected == 0.1


def test_a_head_beyond_what_is_searched_is_searched_from_there():
    head = WORKSPACE.model().replace(timing={"latency_s": 0.4})
    found = search_interval("latency_s", WORKSPACE, head)
    assert (found.low, found.expected, found.high) == (0.0, 0.4, 0.4)


def test_a_head_with_play_is_expected_to_have_it():
    head = WORKSPACE.model().replace(sensor={"backlash_rad": 0.002})
    assert search_interval("backlash_rad", WORKSPACE, head).expected == 0.002


def test_the_size_of_outliers_matters_where_there_are_some():
    assert has_effect("outlier_px", HARDWARE)
    assert not has_effect("outlier_px", WORKSPACE)
    none = dataclasses.replace(HARDWARE.variation, outlier_probability=(0.0, 0.0))
    assert not has_effect("outlier_px", dataclasses.replace(HARDWARE, variation=none))
    assert has_effect("lag_s", WORKSPACE)


def steps_of(limit: float, begin: float, end: float) -> tuple[float, list[float]]:
    asked = []

    def holds(value: float) -> bool:
        asked.append(value)
        return abs(value - begin) <= abs(limit - begin)

    found = last_holding_value(holds, begin, end)
    assert found is not None
    return found, asked


def test_the_limit_is_found_from_the_good_side():
    sides = ((0.0, 0.1), (1.0, 0.1), (66.7, 300.0), (0.0, -5.0))
    for (begin, end), share in itertools.product(sides, (0.004, 0.02, 0.3, 0.999)):
        limit = begin + share * (end - begin)
        found, asked = steps_of(limit, begin, end)
        assert found in asked
        last = max((0.0, *(one for one in GRID_FRACTIONS if one <= share)))
        following = min(one for one in GRID_FRACTIONS if one > share)
        fineness = abs(end - begin) * (following - last) / 2**BISECTIONS
        # six digits of the values' own
        assert 0.0 <= abs(limit - begin) - abs(found - begin) <= fineness + 1e-4 * abs(end - begin)


def test_where_all_of_it_is_good_the_end_itself_is_found():
    asked = [0.1, *(0.1 + 0.2 * share for share in GRID_FRACTIONS)]
    assert steps_of(1.0, 0.1, 0.3) == (0.3, pytest.approx(asked))


def test_a_gap_ends_the_range_whatever_is_beyond_it():
    found = last_holding_value(lambda value: not 0.2 < value < 0.3, 0.0, 1.0)
    assert found == pytest.approx(0.2, abs=0.01)


def test_nothing_is_found_where_not_even_the_beginning_is_good():
    assert last_holding_value(lambda value: value > 0.5, 0.0, 1.0) is None


def test_a_side_without_room_is_its_only_value():
    asked = []
    assert last_holding_value(lambda value: asked.append(value) or True, 0.0, 0.0) == 0.0
    assert asked == [0.0]
