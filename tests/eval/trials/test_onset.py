"""Trials whose targets appear late, and the band that leads: what is counted from when."""

import dataclasses

import numpy as np
import pytest

from tests.eval.trials.toys import PERIOD_S, InTwoTurns, KnowsTheWay, ideal_head, late
from vergence import make_controller
from vergence.eval.trials.results import headline_metric, join_trials
from vergence.eval.trials.run import run_trials
from vergence.eval.trials.scenarios import Scenario


def run(controller, scenario: Scenario, episodes: int = 12):
    return run_trials(controller, scenario, episodes=episodes, head=ideal_head())


def test_settling_counts_from_the_onset() -> None:
    trials = run(KnowsTheWay(60), late(0.1, 0.4))
    assert np.ptp(trials.onset_s) > 0.1
    # a turn at a time of its own, whenever the target has jumped
    assert trials.settle_s() == pytest.approx(61 * PERIOD_S - trials.onset_s, abs=1e-12)
    assert headline_metric(trials) == pytest.approx(np.median(trials.settle_s()))
    assert trials.ratio_to_bound() == pytest.approx(trials.settle_s() / trials.bound_s)
    assert trials.fix_error_at_settling_m() == pytest.approx(trials.fix_error_m[61])


def test_an_onset_at_a_control_step_is_seen_in_the_truth_of_that_step() -> None:
    # 23 periods are not 23 / 120 s to the last bit, but a little less
    for onset_s in (0.1, 23 / 120, 31 / 120):
        trials = run(KnowsTheWay(110), late(onset_s, onset_s), 1)
        step = round(onset_s / PERIOD_S)
        off = np.linalg.norm(trials.error[:, 0], axis=-1).max(axis=-1)
        assert off[step - 1] < 1e-6
        assert off[step] > 10.0


def test_the_bound_of_a_late_target_is_that_of_one_at_once() -> None:
    ids = [run(KnowsTheWay(90), late(onset_s, onset_s), 2).bound_s for onset_s in (0.0, 0.4)]
    assert ids[0] == pytest.approx(ids[1], abs=1e-9)


def test_overshoot_counts_from_the_onset() -> None:
    class TurnsBeyond(KnowsTheWay):
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            action, state = super().predict(observation, state, episode_start)
            return 1.25 * action, state

    trials = run(TurnsBeyond(80), late(0.1, 0.6))
    # the way is 17 px: straight enough for a hundredth
    assert trials.overshoot == pytest.approx(np.full(12, 0.25), abs=0.01)


def test_tracking_counts_from_the_onset_and_the_time_to_catch_up() -> None:
    scenario = late(0.0, 0.4, target={"kind": "circle"}, target_moves=True, catch_up_s=0.3)
    trials = run(make_controller("ibvs", ideal_head()), scenario)
    since = trials.time_s[:, None] - trials.onset_s
    error = np.where(since[..., None, None] >= 0.3 - 1e-9, 3.0, 500.0) * [[1.0, 0.0], [0.0, 1.0]]
    known = dataclasses.replace(trials, error=error)
    assert known.tracking_px == pytest.approx(np.full(12, 3.0))
    shifted = dataclasses.replace(known, onset_s=known.onset_s - 0.1)
    assert (shifted.tracking_px > 100.0).all()


def test_the_leading_band_is_the_scenarios() -> None:
    controller = InTwoTurns(20, 70, 1.5)
    times = {}
    for band_px in (1.0, 2.0):
        trials = run(controller, late(0.0, 0.0, band_px=band_px), 3)
        times[band_px] = headline_metric(trials)
        assert trials.settle_s(2.0) == pytest.approx(np.full(3, 21 * PERIOD_S))
        assert trials.settle_s() == pytest.approx(np.full(3, 71 * PERIOD_S))
        assert trials.ratio_to_bound(2.0) == pytest.approx(21 * PERIOD_S / trials.bounds_s[2.0])
        assert (trials.bounds_s[2.0] <= trials.bound_s).all()
    assert times == pytest.approx({1.0: 71 * PERIOD_S, 2.0: 21 * PERIOD_S})


def test_batches_are_joined_with_their_onsets_and_bounds() -> None:
    whole = run(KnowsTheWay(60), late(0.1, 0.4), 7)
    parts = [
        run_trials(KnowsTheWay(60), late(0.1, 0.4), episodes=n, first_trial=k, head=ideal_head())
        for k, n in ((0, 4), (4, 3))
    ]
    both = join_trials(parts)
    for name in ("onset_s", "bound_s", "residual"):
        assert np.array_equal(getattr(both, name), getattr(whole, name))
    assert np.array_equal(both.settle_s(2.0), whole.settle_s(2.0))
