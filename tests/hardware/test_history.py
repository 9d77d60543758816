"""Joint angles by time: between, before and after the readings."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vergence.hardware.drive import JointHistory

SPEED = np.array([0.5, 0.0, -1.0, 2.0, 0.0, 0.25, -3.0])


def moving(times):
    """A history of joints that all turn at constant speeds from zero at time zero."""
    history = JointHistory()
    for time_s in times:
        history.add(time_s, SPEED * time_s, SPEED)
    return history


@given(st.lists(st.floats(0.001, 0.5), min_size=2, max_size=20), st.floats(0.0, 1.0))
def test_joints_at_constant_speeds_are_known_exactly_at_any_time(steps, share):
    times = np.cumsum(steps)
    asked_s = times[0] + share * (times[-1] - times[0])
    assert moving(times).at(asked_s) == pytest.approx(SPEED * asked_s, abs=1e-12)


def test_joints_rested_before_the_readings_and_go_on_after_them_for_a_twentieth_of_a_second():
    history = moving([1.0, 2.0])
    assert history.at(0.25) == pytest.approx(SPEED)
    assert history.at(2.03) == pytest.approx(SPEED * 2.03)
    assert history.at(7.0) == pytest.approx(SPEED * 2.05)


def test_no_reading_is_no_angle():
    for ask in (lambda: JointHistory().at(0.0), lambda: JointHistory().newest()):
        with pytest.raises(LookupError, match="no reading"):
            ask()


def test_a_reading_is_kept_as_it_was():
    history, angles = JointHistory(), np.ones(7)
    history.add(0.0, angles, np.zeros(7))
    angles[:] = 5.0
    history.at(0.0)[:] = 6.0
    assert (history.at(0.0) == 1.0).all()
    time_s, positions, velocities = history.newest()
    assert (time_s, positions.tolist(), velocities.tolist()) == (0.0, [1.0] * 7, [0.0] * 7)


def test_seconds_of_readings_are_kept_and_no_more():
    history = moving(np.arange(1000) / 120.0)
    assert history.at(999 / 120.0 - 4.0) == pytest.approx(SPEED * (999 / 120.0 - 4.0))
    assert history.at(0.0)[0] > 1.0  # long ago: the oldest that is kept
