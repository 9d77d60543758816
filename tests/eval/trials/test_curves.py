"""Errors over time: they begin where each trial's target appears."""

import numpy as np
import pytest

from tests.eval.trials.toys import PERIOD_S, STEP, KnowsTheWay, ideal_head, late
from vergence.eval.trials.curves import error_quantile_table
from vergence.eval.trials.run import run_trials


def test_without_an_onset_the_curve_is_the_trial() -> None:
    trials = run_trials(KnowsTheWay(5), STEP, episodes=3)
    curves = error_quantile_table(trials)
    assert np.array_equal(curves["time_s"], trials.time_s)
    worse = np.linalg.norm(trials.error, axis=-1).max(axis=-1)
    assert np.array_equal(curves["error_p95_px"], worse.max(axis=-1))


def test_time_counts_from_each_trials_onset() -> None:
    trials = run_trials(KnowsTheWay(60), late(0.1, 0.3), episodes=40, head=ideal_head())
    curves = error_quantile_table(trials)
    assert np.ptp(trials.onset_s) > 0.15
    assert curves["time_s"][0] == 0.0
    # as far as the trial goes on whose target appeared last, to a period
    left = trials.duration_s - trials.onset_s.max()
    assert left - PERIOD_S < curves["time_s"].iloc[-1] <= left + 1e-9
    # all settle at one time after their start; the curve has settled when 95 % of them have
    settled = curves["time_s"][curves["error_p95_px"] <= 1.0].iloc[0]
    slow = np.percentile(trials.settle_s(), 95, method="higher")
    assert settled == pytest.approx(slow, abs=1.5 * PERIOD_S)
