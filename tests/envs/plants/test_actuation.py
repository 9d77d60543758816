"""Plants keep the joints' limits and take commands of one shape."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.envs.trials import start_of, steps
from tests.grids import some_of
from tests.naming import named
from vergence import HeadModel
from vergence.envs.plant import make_plant
from vergence.errors import ConfigurationError


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


def test_a_command_that_is_nan_is_refused_and_moves_nothing(exact: HeadModel) -> None:
    for plant in ["kinematic", "mujoco"]:
        with named(plant):
            heads = make_plant(plant, exact, 2)
            heads.begin(start_of(2))
            command = np.ones((2, 7))
            command[1, 4] = np.nan
            with pytest.raises(ConfigurationError, match=r"command.*nan"):
                heads.step(command)
            assert not heads.truth().positions.any()


def test_a_command_of_another_shape_is_refused(exact: HeadModel) -> None:
    for plant, shape in some_of(["kinematic", "mujoco"], [(7,), (2, 4), (1, 7), (3, 7)]):
        with named(plant, shape):
            heads = make_plant(plant, exact, 2)
            heads.begin(start_of(2))
            with pytest.raises(ConfigurationError, match=r"command: expected shape \(2, 7\)"):
                heads.step(np.zeros(shape))


def swinging(
    head: HeadModel, commands: np.ndarray, overshoot: float, torque_falloff: float
) -> np.ndarray:
    """(periods + 1, 7) angles of joints with a lag of second order, integrated numerically."""
    period, tau, a = head.timing.period_s, head.timing.lag_s, head.limits.acceleration
    zeta = -np.log(overshoot) / np.hypot(np.pi, np.log(overshoot))
    share = torque_falloff / head.limits.velocity
    state, angles = np.zeros(21), [np.zeros(7)]

    def rates(_t: float, state: np.ndarray, u: np.ndarray) -> np.ndarray:
        _q, v, w = state.reshape(3, 7)
        up, down = (a * (1.0 - share * np.maximum(side * v, 0.0)) for side in (1.0, -1.0))
        held = np.clip(w, -down, up)
        swing = (u - v - 2.0 * zeta * tau * held) / tau**2
        # at a limit it goes with this, which falls with speed
        falls = -a * share * held * np.where(held * v > 0.0, np.sign(held), 0.0)
        swing = np.where((w >= up) & (swing > falls), falls, swing)
        swing = np.where((w <= -down) & (swing < -falls), -falls, swing)
        return np.concatenate([v, held, swing])

    for u in commands:
        state = solve_ivp(rates, (0.0, period), state, args=(u,), max_step=4e-4, rtol=1e-7).y[:, -1]
        _q, v, w = state.reshape(3, 7)
        up, down = (a * (1.0 - share * np.maximum(side * v, 0.0)) for side in (1.0, -1.0))
        state[14:] = np.clip(w, -down, up)
        angles.append(state[:7].copy())
    return np.array(angles)


@pytest.mark.slow
def test_a_servo_of_second_order_swings_within_its_acceleration(exact: HeadModel) -> None:
    overshoot, commands = 0.25, np.zeros((26, 7))
    # a limit that falls with speed stays through each eighth of a lag; MuJoCo looks four times a
    # period. The commands are small enough for the lag alone, and far beyond the limit
    commands[:, 3:] = np.where(np.arange(26) < 18, 1.0, -0.5)[:, None] * [0.5, -1.0, 3.0, -5.0]
    for torque_falloff, plants in (
        (0.0, [("kinematic", 2e-5), ("mujoco", 4e-3)]),
        (0.5, [("kinematic", 2e-3)]),
    ):
        options = {"overshoot": overshoot, "torque_falloff": torque_falloff}
        expected = swinging(exact, commands, **options)
        for plant, within_rad in plants:
            with named(plant, torque_falloff):
                heads = make_plant(plant, exact, 1, **options)
                _r, q, v = steps(heads, start_of(), 26, lambda k: commands[k])
                assert q[:, 0] == pytest.approx(expected, abs=within_rad)
                beyond = v[:19, 0, 3].max() / 0.5
                assert beyond == pytest.approx(1.0 + overshoot, abs=0.03)  # at the periods' ends
