"""The linear law calms a servo whose own loop swings."""

import numpy as np
import pytest

from tests.naming import named
from vergence.controllers.state_feedback import pole_placement_command
from vergence.models.motion import follow_held_command, prepare_held_response

LAG_S = 0.03
PERIOD_S = 1.0 / 240.0


def angles(build_up, known, rate=30.0):
    """Angles on the way to 1 rad, under the law that knows of so much build-up."""
    q = v = w = 0.0
    way = []
    for _ in range(240):
        u = pole_placement_command(1.0 - q, v, w, rate, LAG_S, known)
        q, v, w = follow_held_command(
            q, v, w, u, prepare_held_response(LAG_S, build_up, np.inf, PERIOD_S)
        )
        way.append(q)
    return np.array(way)


def test_a_servo_that_overshoots_hardly_passes_its_goal() -> None:
    for build_up in [1.0, 2.0]:
        with named(build_up):
            way = angles(build_up, build_up)
            assert way.max() < 1.01
            assert angles(build_up, 0.0).max() > 1.05
            assert abs(way[-1] - 1.0) < 1e-3


def test_a_law_without_a_build_up_is_that_of_two_poles() -> None:
    found = pole_placement_command(0.1, 0.5, 7.0, 20.0, 0.03, 0.0)
    assert found == pytest.approx(20.0 * (0.1 - 0.015))
