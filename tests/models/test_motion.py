"""Response of a joint to velocity commands: the exact lag of first or second order, and limits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.naming import named
from vergence.models.motion import (
    follow_held_command,
    follow_joint,
    follow_torque_limited_joint,
    lag_decay,
    prepare_held_response,
)

speeds = st.floats(-6.0, 6.0)


def follow_one(q, v, u, *, tau, a, period):
    return follow_joint(q, v, u, tau, a, period, lag_decay(period, tau))


def integrate(q, v, slope, period, count=4000):
    """Heun's rule on `dv/dt = slope(v), dq/dt = v`, for arrays of cases."""
    h = period / count
    for _ in range(count):
        ahead = v + h * slope(v)
        after = v + 0.5 * h * (slope(v) + slope(ahead))
        q, v = q + 0.5 * h * (v + after), after
    return q, v


def test_closed_form_is_the_solution_of_the_equation_of_motion() -> None:
    rng = np.random.default_rng(1)
    n = 500
    q, v, u = rng.uniform(-1, 1, n), rng.uniform(-6, 6, n), rng.uniform(-6, 6, n)
    tau, a = rng.uniform(0.005, 0.08, n), rng.uniform(20.0, 300.0, n)
    period = 0.025  # long enough that many cases leave the acceleration limit on the way
    left_limit = (np.abs(u - v) > a * tau) & (np.abs(u - v) < a * (tau + period))
    assert left_limit.sum() > 50
    expected_q, expected_v = integrate(q, v, lambda rate: np.clip((u - rate) / tau, -a, a), period)
    rows = zip(q, v, u, tau, a, strict=True)
    got = np.array([follow_one(*row[:3], tau=row[3], a=row[4], period=period) for row in rows])
    # Heun's error where the limit ends within a step: h^2 a / tau, some 1e-7 rad/s here
    assert np.abs(got[:, 0] - expected_q).max() < 1e-8
    assert np.abs(got[:, 1] - expected_v).max() < 1e-6


def test_a_lag_or_a_limit_alone_has_a_closed_form() -> None:
    for (q, v, u), tau, a, period, wanted in [
        # the area under the exponential of a lag
        ((0.0, 0.0, 1.0), 0.03, np.inf, 0.03, (0.03 * np.exp(-1.0), 1.0 - np.exp(-1.0))),
        ((0.2, -5.0, 3.0), 0.0, np.inf, 0.01, (0.23, 3.0)),
        # 3 rad/s at 120 rad/s^2 take 25 ms, the remaining 25 ms run at full speed
        ((0.0, 0.0, 3.0), 0.0, 120.0, 0.05, (0.5 * 3.0 * 0.025 + 3.0 * 0.025, 3.0)),
    ]:
        found = follow_one(q, v, u, tau=tau, a=a, period=period)
        assert found == pytest.approx(wanted, abs=1e-15)


def test_a_motor_whose_torque_falls_with_its_speed_is_the_solution_of_its_equation() -> None:
    rng = np.random.default_rng(2)
    n, period = 400, 0.04
    v, u = rng.uniform(-6, 6, n), rng.uniform(-6, 6, n)
    tau, a = rng.uniform(0.005, 0.08, n), rng.uniform(20.0, 200.0, n)
    torque_falloff = rng.uniform(0.01, 0.8, n) / 6.0
    rows = zip(v, u, tau, a, torque_falloff, strict=True)
    got = np.array([follow_torque_limited_joint(0.0, *row, period) for row in rows])

    def slope(rate):
        up = a * (1.0 - torque_falloff * np.maximum(rate, 0.0))
        down = a * (1.0 - torque_falloff * np.maximum(-rate, 0.0))
        return np.clip((u - rate) / tau, -down, up)

    q, rate = integrate(np.zeros(n), v, slope, period)
    # Heun's error where a limit ends within a step, see above: h^2 a / tau
    assert np.abs(got[:, 0] - q).max() < 1e-7
    assert np.abs(got[:, 1] - rate).max() < 1e-5
    rows = zip(v, u, tau, a, strict=True)
    plain = [follow_one(0.0, *row[:2], tau=row[2], a=row[3], period=period) for row in rows]
    assert np.abs(got - plain).max(axis=0).min() > 0.005


@given(v=speeds, u=speeds, split=st.floats(0.01, 0.99), tau=st.sampled_from([0.0, 0.01, 0.03]))
def test_two_parts_of_a_period_make_the_whole(v, u, split, tau) -> None:
    def plain(q, v, part):
        return follow_one(q, v, u, tau=tau, a=120.0, period=0.05 * part)

    def fading(q, v, part):
        return follow_torque_limited_joint(q, v, u, tau, 120.0, 0.1, 0.05 * part)

    for follow, within in ((plain, 1e-12), (fading, 1e-10)):
        parts = follow(*follow(0.0, v, split), 1.0 - split)
        assert parts == pytest.approx(follow(0.0, v, 1.0), abs=within)


PERIOD_S = 1.0 / 60.0
LAG_S = 0.04


def swing(v, w, u, build_up, a, period=PERIOD_S, count=20000):
    """Euler's rule, half implicit, on the equation of motion, from zero; build-ups broadcast."""
    q, h = 0.0, period / count
    for _ in range(count):
        w = np.clip(w + h * (u - v - LAG_S * w) / (build_up * LAG_S**2), -a, a)
        q, v = q + h * (v + 0.5 * h * w), v + h * w
    return q, v, w


@pytest.mark.slow
def test_a_held_command_solves_the_equation_of_motion() -> None:
    build_ups = np.array([0.05, 0.25, 0.9, 2.0])
    expected = np.stack(swing(1.0, -30.0, 4.0, build_ups, np.inf), axis=-1)
    for build_up, solved in zip(build_ups, expected, strict=True):
        response = prepare_held_response(LAG_S, build_up, np.inf, PERIOD_S)
        with named(build_up):
            found = follow_held_command(0.0, 1.0, -30.0, 4.0, response)
            assert found == pytest.approx(solved, abs=3e-3)


def test_no_acceleration_of_a_held_command_passes_its_limit() -> None:
    build_ups = np.array([0.05, 0.25, 0.9])
    for u in (6.0, -3.0):
        expected = swing(1.0, 10.0, u, build_ups, 50.0, count=5000)
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
