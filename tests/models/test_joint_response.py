"""How a joint follows a velocity command: the exact lag with its limits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.envs.trials import start_of, steps
from vergence import HeadModel
from vergence.envs.plant import make_plant
from vergence.errors import ConfigurationError
from vergence.models.joint_response import follow

FREE = np.full(7, 1e9)
speeds = st.floats(-6.0, 6.0)


def follow_one(q, v, u, *, tau, a, period, lower=-FREE, upper=FREE):
    """One joint through one period; the other six stay at rest."""
    angles, rates, commands = np.zeros((3, 1, 7))
    angles[0, 0], rates[0, 0], commands[0, 0] = q, v, u
    follow(angles, rates, commands, np.array([tau]), np.full(7, a), lower, upper, period)
    assert not angles[0, 1:].any()
    return angles[0, 0], rates[0, 0]


def integrate(q, v, u, tau, a, period, count=4000):
    """Heun's rule on `dv/dt = clip((u - v) / tau, -a, a), dq/dt = v`, for arrays of cases."""
    h = period / count

    def slope(rate):
        return np.clip((u - rate) / tau, -a, a)

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
    expected_q, expected_v = integrate(q, v, u, tau, a, period)
    got = np.array(
        [
            follow_one(*row[:3], tau=row[3], a=row[4], period=period)
            for row in zip(q, v, u, tau, a, strict=True)
        ]
    )
    # Heun's error where the limit ends within a step: h^2 a / tau, some 1e-7 rad/s here
    assert np.abs(got[:, 0] - expected_q).max() < 1e-8
    assert np.abs(got[:, 1] - expected_v).max() < 1e-6


@given(v=speeds, u=speeds, split=st.floats(0.01, 0.99), tau=st.sampled_from([0.0, 0.01, 0.03]))
def test_two_parts_of_a_period_make_the_whole(v, u, split, tau) -> None:
    period = 0.05
    whole = follow_one(0.0, v, u, tau=tau, a=120.0, period=period)
    part = follow_one(0.0, v, u, tau=tau, a=120.0, period=split * period)
    parts = follow_one(*part, u, tau=tau, a=120.0, period=(1.0 - split) * period)
    assert parts == pytest.approx(whole, abs=1e-12)


@given(v=speeds, u=speeds)
def test_speed_changes_no_faster_than_the_acceleration_limit(v, u) -> None:
    period = 1 / 120
    _q, after = follow_one(0.0, v, u, tau=0.001, a=120.0, period=period)
    assert abs(after - v) <= 120.0 * period + 1e-12


def test_a_large_step_begins_at_the_acceleration_limit() -> None:
    # until the gap is a tau = 3.6 rad/s the joint accelerates by 120 rad/s^2: 6 rad/s from rest
    # do so for 20 ms, and a period of 1/120 s is all limit
    q, v = follow_one(0.0, 0.0, 6.0, tau=0.03, a=120.0, period=1 / 120)
    assert v == pytest.approx(1.0, abs=1e-12)
    assert q == pytest.approx(0.5 / 120, abs=1e-12)


def test_a_pure_lag_covers_the_area_under_its_exponential() -> None:
    q, v = follow_one(0.0, 0.0, 1.0, tau=0.03, a=np.inf, period=0.03)
    assert v == pytest.approx(1.0 - np.exp(-1.0), abs=1e-15)
    assert q == pytest.approx(0.03 * np.exp(-1.0), abs=1e-15)


def test_without_lag_and_limit_the_command_is_the_motion() -> None:
    q, v = follow_one(0.2, -5.0, 3.0, tau=0.0, a=np.inf, period=0.01)
    assert (q, v) == pytest.approx((0.23, 3.0), abs=1e-15)


def test_without_lag_the_speed_ramps_to_the_command() -> None:
    # 3 rad/s at 120 rad/s^2 take 25 ms, the remaining 25 ms run at full speed
    q, v = follow_one(0.0, 0.0, 3.0, tau=0.0, a=120.0, period=0.05)
    assert v == pytest.approx(3.0, abs=1e-12)
    assert q == pytest.approx(0.5 * 3.0 * 0.025 + 3.0 * 0.025, abs=1e-12)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_joint_stops_at_its_limit(side) -> None:
    lower, upper = np.full(7, -0.5), np.full(7, 0.5)
    q, v = follow_one(
        side * 0.49,
        side * 6.0,
        side * 6.0,
        tau=0.03,
        a=120.0,
        period=0.02,
        lower=lower,
        upper=upper,
    )
    assert (q, v) == (side * 0.5, 0.0)


def test_a_joint_leaves_its_limit_when_told() -> None:
    lower, upper = np.full(7, -0.5), np.full(7, 0.5)
    q, v = follow_one(0.5, 0.0, -1.0, tau=0.03, a=120.0, period=0.02, lower=lower, upper=upper)
    assert q < 0.5
    assert v < 0.0


@pytest.mark.parametrize("plant", ["kinematic", "mujoco"])
def test_every_joint_stops_at_both_its_limits(exact: HeadModel, plant) -> None:
    limits = exact.limits
    for side, end in ((-1.0, limits.lower), (1.0, limits.upper)):
        heads = make_plant(plant, exact, 1)
        # a second and a half is enough for the slowest joint to cross all of its range
        _r, positions, velocities = steps(heads, start_of(), 180, side * limits.velocity)
        assert positions[-1, 0] == pytest.approx(end, abs=5e-3)  # MuJoCo's stops are springs
        assert np.abs(velocities[-1]).max() < 1e-2
        beyond = np.maximum(positions - limits.upper, limits.lower - positions).max()
        assert beyond < 0.05  # what the layout of observations leaves room for


@pytest.mark.parametrize("plant", ["kinematic", "mujoco"])
def test_speed_stays_below_the_joints_greatest_command(exact: HeadModel, plant) -> None:
    heads = make_plant(plant, exact, 1)
    _r, _q, velocities = steps(heads, start_of(), 20, 100.0 * exact.limits.velocity)
    assert (np.abs(velocities) <= exact.limits.velocity * (1 + 1e-3)).all()
    assert np.abs(velocities[-1, 0, 3]) > 5.0


@pytest.mark.parametrize("plant", ["kinematic", "mujoco"])
def test_a_command_that_is_nan_is_refused_and_moves_nothing(exact: HeadModel, plant) -> None:
    heads = make_plant(plant, exact, 2)
    heads.begin(start_of(2))
    command = np.ones((2, 7))
    command[1, 4] = np.nan
    with pytest.raises(ConfigurationError, match=r"joint_velocity.*nan"):
        heads.step(command)
    assert not heads.truth().positions.any()


@pytest.mark.parametrize("plant", ["kinematic", "mujoco"])
@pytest.mark.parametrize("shape", [(7,), (2, 4), (1, 7), (3, 7)])
def test_a_command_of_another_shape_is_refused(exact: HeadModel, plant, shape) -> None:
    heads = make_plant(plant, exact, 2)
    heads.begin(start_of(2))
    with pytest.raises(ConfigurationError, match=r"joint_velocity: expected shape \(2, 7\)"):
        heads.step(np.zeros(shape))
