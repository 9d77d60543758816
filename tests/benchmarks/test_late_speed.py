"""Laws on servos that read their speeds late."""

import pytest

from benchmarks.late_speed import held


@pytest.mark.parametrize("reading", ["filtered 80 ms", "over 4 periods"])
def test_the_law_that_robots_are_told_to_begin_with_holds_its_target(reading):
    found = held("state-feedback", "turrets", reading, 20)
    assert found["settled"] == 1.0
    assert found["swing_deg_s"] < 2.0


def test_a_late_speed_makes_the_fastest_law_swing():
    assert held("saccade", "turrets", "over 4 periods", 20)["swing_deg_s"] > 100.0
