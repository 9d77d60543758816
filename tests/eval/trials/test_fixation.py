"""Metrics of fixation on trajectories whose answer is known, and a law that swings."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from tests.eval.trials.toys import PERIOD_S, STEP, KnowsTheWay, Shaking, ideal_head
from tests.naming import named
from vergence.envs.plant import PLANTS
from vergence.eval.margins.run import MarginMeasurement
from vergence.eval.trials.fixation import (
    detect_band_exits,
    detect_oscillation,
    fixation_window_start,
    worst_joint_speed_range,
    worst_joint_speed_rms,
)
from vergence.eval.trials.run import headline_metric, run_trials
from vergence.eval.trials.scenarios import Scenario

TIME = np.arange(361) * PERIOD_S
"""Three seconds."""


def speeds(degrees_s) -> np.ndarray:
    out = np.zeros((len(TIME) - 1, 4))
    out[:, 1] = np.deg2rad(degrees_s)
    return out


def sinusoid(peak_to_peak: float, hertz: float) -> np.ndarray:
    return speeds(0.5 * peak_to_peak * np.sin(2.0 * np.pi * hertz * TIME[:-1]))


def pulse(begin_s: float, lasts_s: float, degrees_s: float = 300.0) -> np.ndarray:
    inside = (TIME[:-1] >= begin_s - 1e-9) & (TIME[:-1] < begin_s + lasts_s - 1e-9)
    return speeds(np.where(inside, degrees_s, 0.0))


def error(px) -> np.ndarray:
    """(361, 2, 2) of the left eye along u, from the first values on; then the last one."""
    out = np.zeros((len(TIME), 2, 2))
    out[:, 0, 0] = np.append(px, np.full(len(TIME) - len(px), px[-1]))
    return out


def test_a_trial_is_judged_by_its_last_seconds_or_half_once_the_eyes_could_approach():
    assert fixation_window_start([0.0, 0.6], 8.0) == pytest.approx([3.0, 3.0])
    assert fixation_window_start([0.0, 0.6], 3.0) == pytest.approx([1.5, 1.8])
    assert fixation_window_start(0.0, 6.0) == pytest.approx(2.0)


def test_a_sinusoid_has_its_peak_to_peak_and_its_rms():
    swing = sinusoid(10.0, 5.0)
    assert np.rad2deg(worst_joint_speed_range(TIME, swing, 1.0)) == pytest.approx(10.0, rel=0.01)
    rms = np.rad2deg(worst_joint_speed_rms(TIME, swing, 1.0))
    assert rms == pytest.approx(5.0 / np.sqrt(2.0), rel=0.01)


def test_a_drift_has_an_rms_and_no_peak_to_peak():
    drift = speeds(0.7)
    assert worst_joint_speed_range(TIME, drift, 1.0) == 0.0
    assert np.rad2deg(worst_joint_speed_rms(TIME, drift, 1.0)) == pytest.approx(0.7)


def test_speed_counts_from_each_trials_own_time():
    turn = np.stack([pulse(1.0, 0.1), pulse(1.0, 0.1)], axis=1)
    spans = np.rad2deg(worst_joint_speed_range(TIME, turn, [0.9, 1.2]))
    assert spans == pytest.approx([300.0, 0.0])
    assert worst_joint_speed_rms(TIME, turn, [0.9, 1.2])[1] == 0.0


def test_a_trial_that_is_over_by_then_has_no_speed():
    assert np.isnan(worst_joint_speed_range(TIME, speeds(1.0), 3.5))
    assert np.isnan(worst_joint_speed_rms(TIME, speeds(1.0), 3.5))


def test_a_sinusoid_swings_from_a_peak_to_peak_on():
    for hertz, least in [(2.0, 40.0), (3.0, 23.5), (5.0, 20.0), (10.0, 20.0), (30.0, 20.0)]:
        with named(hertz):
            assert detect_oscillation(TIME, sinusoid(1.05 * least, hertz), 0.0)
            assert not detect_oscillation(TIME, sinusoid(0.95 * min(least, 20.0), hertz), 0.0)


def test_neither_one_turn_of_half_a_second_nor_a_slow_drift_is_a_swing():
    assert not detect_oscillation(TIME, pulse(1.2, 0.5), 0.0)
    assert not detect_oscillation(TIME, speeds(np.linspace(-30.0, 30.0, 360)), 0.0)


def ringing(until_s: float) -> np.ndarray:
    return sinusoid(200.0, 5.0) * (TIME[:-1] < until_s)[:, None]


def test_how_the_eyes_get_to_the_target_is_no_swing():
    assert not detect_oscillation(TIME, ringing(1.4), 0.0)
    assert detect_oscillation(TIME, ringing(1.8), 0.0)


def test_each_trial_has_its_own_onset():
    two = np.stack([ringing(1.8), ringing(1.8)], axis=1)
    assert detect_oscillation(TIME, two, [0.0, 0.5]).tolist() == [True, False]


def test_swings_of_two_joints_by_turns_are_one():
    first = sinusoid(200.0, 5.0)
    first[TIME[:-1] % 0.8 < 0.4] = 0.0
    other = np.roll(np.roll(first, 2, axis=-1), 48, axis=0)
    assert not detect_oscillation(TIME, first, 0.0)
    assert detect_oscillation(TIME, first + other, 0.0)


def test_a_trial_too_short_to_tell_does_not_swing():
    assert not detect_oscillation(TIME[:100], sinusoid(200.0, 5.0)[:99], 0.0)


def test_a_trial_has_left_again_if_it_was_in_the_band_for_a_while():
    way = [9.0] * 20
    for after, left in [
        ([0.5] * 30 + [3.0] * 10 + [0.5], True),
        ([0.5] * 30 + [np.nan] * 3 + [0.5], True),  # lost sight of the target
        ([0.5], False),
        ([0.5] * 10 + [-3.0] * 10 + [0.5], False),  # overshoot: less than a tenth of a second
    ]:
        assert detect_band_exits(TIME, error(way + after), 1.0, 0.0) == left


def test_what_was_held_before_the_onset_does_not_count():
    held = error([0.5] * 60 + [9.0] * 20 + [0.5])
    assert detect_band_exits(TIME, held, 1.0, 0.0)
    assert not detect_band_exits(TIME, held, 1.0, 60 * PERIOD_S)


HELD = dataclasses.replace(STEP, duration_s=2.0, band_px=8.0)
SHARE = 0.03
"""At 10 Hz far from the band's edge, and peak to peak well beyond 20 degrees/s."""


def shaken(whose: tuple[int, ...], scenario: Any = HELD, **options: Any):
    law = Shaking(KnowsTheWay(5), SHARE, 10.0, whose)
    return run_trials(law, scenario, episodes=4, **options)


def test_a_law_that_swings_has_settled_nothing():
    trials = shaken((0, 1, 2, 3))
    assert (np.linalg.norm(trials.error[12:], axis=-1) < HELD.band_px).all()
    assert trials.swings.all()
    assert np.isnan(trials.settle_s(HELD.band_px)).all()
    assert np.isinf(trials.ratio_to_bound()).all()
    assert headline_metric(trials) == HELD.duration_s


def test_the_speed_while_fixating_is_that_of_the_commands():
    trials = shaken((1, 3))
    amplitude = SHARE * ideal_head().limits.velocity[4]
    assert trials.fixation_peak_to_peak_rad_s[1::2] == pytest.approx(2.0 * amplitude, rel=0.01)
    assert trials.fixation_rms_rad_s[1::2] == pytest.approx(amplitude / np.sqrt(2.0), rel=0.01)
    assert trials.fixation_peak_to_peak_rad_s[::2] == pytest.approx(0.0, abs=1e-9)


def test_without_truth_the_speed_is_that_of_the_measured_angles(monkeypatch):
    monkeypatch.setitem(PLANTS, "blind", "tests.eval.trials.toys:BlindPlant")
    measured, true = (shaken((1, 3), plant=plant) for plant in ("blind", "kinematic"))
    assert measured.swings.tolist() == true.swings.tolist()
    found, expected = (one.fixation_peak_to_peak_rad_s[1::2] for one in (measured, true))
    assert found == pytest.approx(expected, rel=0.05)


def test_of_a_target_that_never_rests_there_is_no_fixation():
    trials = shaken((0, 1), dataclasses.replace(HELD, target_moves=True))
    assert not trials.swings.any()
    assert not trials.left_again.any()
    assert np.isnan(trials.fixation_peak_to_peak_rad_s).all()
    assert np.isnan(trials.fixation_rms_rad_s).all()


def test_a_motor_that_swings_within_its_play_swings():
    scenario = Scenario(name="play", description="a step", target=STEP.target, duration_s=2.0)
    head = ideal_head().replace(sensor={"backlash_rad": 0.02})
    trials = run_trials(Shaking(KnowsTheWay(5), SHARE, 10.0, (1,)), scenario, episodes=2, head=head)
    assert trials.swings.tolist() == [False, True]


def test_a_point_of_margins_tells_how_many_swing_and_counts_none_of_them():
    scenario = Scenario(
        name="known", description="a step", target=STEP.target, duration_s=2.0, band_px=8.0
    )
    whose: list[int] = []

    def run(scenario: Scenario):
        law = Shaking(KnowsTheWay(5), SHARE, 10.0, tuple(whose))
        return run_trials(law, scenario, episodes=4, head=ideal_head())

    measure = MarginMeasurement(run, scenario, "command_latency_s")
    whose += [1, 3]
    point = measure(0.01)
    assert (point.trials, point.settled, point.swinging) == (4, 2, 2)
    # where nothing settles untouched too
    whose += [0, 2]
    point = MarginMeasurement(run, scenario, "command_latency_s")(0.01)
    assert (point.trials, point.settled, point.swinging) == (0, 0, 4)
