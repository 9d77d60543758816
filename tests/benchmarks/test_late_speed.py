"""Laws on servos that read their speeds late."""

import pytest

from benchmarks.late_speed import held


@pytest.mark.parametrize("law", ["saccade", "state-feedback"])
@pytest.mark.parametrize("reading", ["filtered 80 ms", "over 4 periods"])
def test_a_law_holds_its_target_where_speeds_are_read_late(law, reading):
    found = held(law, "turrets", reading, 20)
    assert found["settled"] == 1.0
    assert found["swing_deg_s"] < 2.0
