"""Ranges in which margins are searched."""

import dataclasses

import numpy as np

from vergence.envs.plants.imperfections import IMPERFECTIONS, LOOP_PARTS, is_valid_range
from vergence.envs.plants.variation import RANGES
from vergence.eval.margins.ranges import IMPERFECTION_RANGES, has_effect, search_interval
from vergence.eval.trials.scenarios import load_scenario

WORKSPACE, HARDWARE = load_scenario("workspace"), load_scenario("hardware")


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
