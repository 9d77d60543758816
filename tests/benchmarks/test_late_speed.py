"""Laws on servos that read their speeds late."""

import pytest

from benchmarks.late_speed import Difference4, Filtered80, held


@pytest.mark.parametrize("plant", [Filtered80, Difference4])
def test_the_law_that_robots_are_told_to_begin_with_holds_its_target(plant):
    found = held("state-feedback", "turrets", plant, 20)
    assert found["settled"] == 1.0
    assert found["swing_deg_s"] < 2.0


def test_a_late_speed_makes_the_fastest_law_swing():
    assert held("saccade", "turrets", Difference4, 20)["swing_deg_s"] > 100.0
