"""Settle time and overshoot on trajectories whose answer is known."""

import numpy as np
import pytest

from vergence.eval.metrics import overshoot, settle_time


def both(values) -> np.ndarray:
    """(steps, 2, 2) errors that are the same for both eyes, along v."""
    out = np.zeros((len(values), 2, 2))
    out[:, :, 1] = np.asarray(values)[:, None]
    return out


TIME = np.arange(6) / 10.0


def test_settling_is_when_the_error_enters_the_band_to_stay():
    assert settle_time(TIME, both([9, 0.5, 2, 0.5, 0.4, 0.3]), 1.0) == pytest.approx(0.3)


def test_the_slower_eye_counts():
    error = both([9, 0.5, 0.5, 0.5, 0.5, 0.5])
    error[:4, 1, 0] = 3.0
    assert settle_time(TIME, error, 1.0) == pytest.approx(0.4)


def test_an_error_that_leaves_the_band_at_the_end_never_settled():
    assert np.isnan(settle_time(TIME, both([9, 0, 0, 0, 0, 1.0]), 1.0))


def test_an_unseen_target_is_not_settled():
    assert np.isnan(settle_time(TIME, both([9, 0, 0, 0, 0, np.nan]), 1.0))


def test_an_error_within_the_band_throughout_settles_at_time_zero():
    assert settle_time(TIME, both([0.1] * 6), 1.0) == 0.0


def test_trials_are_judged_one_by_one():
    errors = np.stack([both([9, 0, 0, 0, 0, 0]), both([9] * 6)], axis=1)
    times = settle_time(TIME, errors, 1.0)
    assert times[0] == pytest.approx(0.1)
    assert np.isnan(times[1])


def test_overshoot_is_the_largest_excursion_beyond_zero_by_the_initial_error():
    assert overshoot(both([10, 5, -0.3, -0.2, 0.1, 0])) == pytest.approx(0.03)


def test_an_error_that_only_falls_does_not_overshoot():
    assert overshoot(both([10, 5, 3, 2, 1, 0.5])) == 0.0


def test_the_worse_eye_counts_for_overshoot():
    error = both([10, 5, 1, 0, 0, 0])
    error[3, 1, 1] = -1.0
    assert overshoot(error) == pytest.approx(0.1)
