"""Metrics on trajectories whose answer is known."""

import numpy as np
import pytest

from tests.naming import named
from vergence.eval.trials.metrics import (
    binocular_rms_error,
    command_energy,
    command_peak,
    overshoot_fraction,
    settle_time,
    steady_state_rms,
    tracking_lag,
    tracking_rms,
    value_at_time,
)


def both(values) -> np.ndarray:
    """(steps, 2, 2) errors that are the same for both eyes, along v."""
    out = np.zeros((len(values), 2, 2))
    out[:, :, 1] = np.asarray(values)[:, None]
    return out


TIME = np.arange(6) / 10.0


def test_settling_is_when_the_slower_eyes_error_enters_the_band_to_stay():
    for values, settled in [
        ([9, 0.5, 2, 0.5, 0.4, 0.3], 0.3),
        ([9, 0, 0, 0, 0, 1.0], np.nan),  # it leaves at the end
        ([9, 0, 0, 0, 0, np.nan], np.nan),  # it is not seen
        ([0.1] * 6, 0.0),
    ]:
        with named(values):
            assert settle_time(TIME, both(values), 1.0) == pytest.approx(settled, nan_ok=True)
    error = both([9, 0.5, 0.5, 0.5, 0.5, 0.5])
    error[:4, 1, 0] = 3.0
    assert settle_time(TIME, error, 1.0) == pytest.approx(0.4)


def test_trials_are_judged_one_by_one():
    errors = np.stack([both([9, 0, 0, 0, 0, 0]), both([9] * 6)], axis=1)
    times = settle_time(TIME, errors, 1.0)
    assert times[0] == pytest.approx(0.1)
    assert np.isnan(times[1])


def test_overshoot_is_the_worse_eyes_largest_excursion_beyond_zero_by_its_initial_error():
    for values, overshoot in [
        ([10, 5, -0.3, -0.2, 0.1, 0], 0.03),
        ([10, 5, 3, 2, 1, 0.5], 0.0),
        ([0, 5, 1, 0, 0, 0], 0.0),  # no error to reduce
        ([10, np.nan, -1, 0, 0, 0], 0.1),  # out of sight for a while
    ]:
        with named(values):
            assert overshoot_fraction(both(values)) == pytest.approx(overshoot)
    error = both([10, 5, 1, 0, 0, 0])
    error[3, 1, 1] = -1.0
    assert overshoot_fraction(error) == pytest.approx(0.1)


def test_overshoot_counts_from_each_trials_own_onset():
    one = both([3, -2, 10, 5, -0.3, 0])  # before its onset the eyes may look anywhere
    other = both([0, 0, 0, 0, 4, -1])
    errors = np.stack([one, other], axis=1)
    assert overshoot_fraction(errors, [2, 4]) == pytest.approx([0.03, 0.25])
    assert overshoot_fraction(errors, 0)[0] == pytest.approx(2 / 3)


def test_tracking_counts_from_each_trials_own_time():
    errors = np.stack([both([50, 50, 3, 3, 3, 3]), both([50, 50, 50, 50, 4, 4])], axis=1)
    assert tracking_rms(TIME, errors, 100.0, after_s=[0.2, 0.4]) == pytest.approx([3.0, 4.0])
    assert np.isnan(tracking_rms(TIME, both([1] * 6), 100.0, after_s=9.0))
    velocity = np.ones_like(errors)
    lags = tracking_lag(TIME, errors, velocity, after_s=[0.2, 0.4])
    assert lags == pytest.approx([1.5, 2.0])  # along v alone, of u and v


def test_the_steady_state_error_is_that_of_the_end_alone():
    error = both([9, 9, 9, 9, 0.3, 0.4])
    assert steady_state_rms(TIME, error, 100.0, window_s=0.15) == pytest.approx(np.sqrt(0.125))


def test_an_error_that_is_missing_counts_as_the_stated_size():
    error = both([0, 0, 0, 0, 0, np.nan])
    assert tracking_rms(TIME, error, 100.0, after_s=0.45) == pytest.approx(100.0)
    assert np.isnan(binocular_rms_error(error[-1], 100.0)).sum() == 0


def test_the_lag_is_the_error_by_the_velocity_and_a_constant_bias_of_a_turn_does_not_count():
    time = np.linspace(0.0, 2.0, 201)
    velocity = both(30.0 * np.cos(2.0 * np.pi * time))
    error = 0.2 * velocity + 5.0
    lags = tracking_lag(time, error[:, None], velocity[:, None], after_s=1.001)
    assert lags == pytest.approx([0.2])
    assert tracking_lag(time, -error, velocity, after_s=1.001) == pytest.approx(-0.2)
    assert np.isnan(tracking_lag(time, error, 0.0 * velocity, after_s=1.0))


def test_energy_integrates_the_square_and_the_peak_is_the_largest_of_either_sign():
    command = np.zeros((6, 3, 4))
    command[:, 1] = [1.0, -2.0, 0.0, 0.0]
    assert command_energy(command, 0.1) == pytest.approx([0.0, 3.0, 0.0])
    assert command_peak(command) == pytest.approx([0.0, 2.0, 0.0])


def test_a_value_at_a_time_of_each_trials_own():
    values = np.arange(12.0).reshape(6, 2)
    assert value_at_time(TIME, values, [0.2, 0.5]) == pytest.approx([4.0, 11.0])
    assert np.isnan(value_at_time(TIME, values, [np.nan, 0.5])).tolist() == [True, False]
