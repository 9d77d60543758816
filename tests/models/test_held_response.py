"""Response of a joint to commands of equal duration, with a first- or second-order lag."""

import numpy as np
import pytest

from tests.naming import named
from vergence.models.motion import (
    follow_held_command,
    follow_joint,
    lag_decay,
    prepare_held_response,
)

PERIOD_S = 1.0 / 60.0
LAG_S = 0.04


def integrate(v, w, u, build_up, a, period=PERIOD_S, count=20000):
    """Euler's rule, half implicit, on the equation of motion, from zero; build-ups broadcast."""
    q, h = 0.0, period / count
    for _ in range(count):
        w = np.clip(w + h * (u - v - LAG_S * w) / (build_up * LAG_S**2), -a, a)
        q, v = q + h * (v + 0.5 * h * w), v + h * w
    return q, v, w


@pytest.mark.slow
def test_it_solves_the_equation_of_motion() -> None:
    build_ups = np.array([0.05, 0.25, 0.9, 2.0])
    expected = np.stack(integrate(1.0, -30.0, 4.0, build_ups, np.inf), axis=-1)
    for build_up, solved in zip(build_ups, expected, strict=True):
        response = prepare_held_response(LAG_S, build_up, np.inf, PERIOD_S)
        with named(build_up):
            found = follow_held_command(0.0, 1.0, -30.0, 4.0, response)
            assert found == pytest.approx(solved, abs=3e-3)


def test_no_acceleration_passes_its_limit() -> None:
    build_ups = np.array([0.05, 0.25, 0.9])
    for u in (6.0, -3.0):
        expected = integrate(1.0, 10.0, u, build_ups, 50.0, count=5000)
        for build_up, angle, speed in zip(build_ups, *expected[:2], strict=True):
            response = prepare_held_response(LAG_S, build_up, 50.0, PERIOD_S)
            q, v, w = follow_held_command(0.0, 1.0, 10.0, u, response)
            with named(build_up, u):
                assert abs(w) <= 50.0
                assert q == pytest.approx(angle, abs=2e-4)  # of 16 mrad
                assert v == pytest.approx(speed, abs=0.03)
    # without a build-up it is the lag of first order
    response = prepare_held_response(LAG_S, 0.0, 40.0, PERIOD_S)
    q, v, w = follow_held_command(0.1, 1.0, 5.0, 4.0, response)
    expected = follow_joint(0.1, 1.0, 4.0, LAG_S, 40.0, PERIOD_S, lag_decay(PERIOD_S, LAG_S))
    assert (q, v) == expected
    assert w == 40.0
