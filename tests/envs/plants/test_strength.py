"""Strength of motors: gain of the speed, greatest acceleration, torque falling with speed."""

import numpy as np
import pytest

from tests.envs.plants.trajectory import motion_of, swing
from tests.envs.trials import start_of, steps
from tests.naming import named
from vergence import HeadModel
from vergence.envs.plant import make_plant

T = 1 / 120
# the kinematic plant is exact; in MuJoCo a force limit holds for a quarter of a period, and the
# implicit integration leaves an acceleration limit by a time step late
PLANTS = [("kinematic", 1e-8), ("mujoco", 2e-3)]
plants = pytest.mark.parametrize(("plant_name", "within_rad"), PLANTS)
GAINS = np.array([0.7, 0.9, 1.1, 1.3])


def full(count: int, head: HeadModel) -> np.ndarray:
    """(count, 7) full speed one way, then the other."""
    sign = np.where(np.arange(count) < count // 2, 1.0, -1.0)[:, None]
    return sign * head.limits.velocity * [0, 0, 0, 1, -1, 1, -1]


def run(plant_name: str, head: HeadModel, commands: np.ndarray, **options: object) -> np.ndarray:
    """(count + 1, 7) angles."""
    own = {"neck": "welded"} if plant_name == "mujoco" else {}
    plant = make_plant(plant_name, head, 1, **options, **own)
    return steps(plant, start_of(), len(commands), lambda k: commands[k])[1][:, 0]


@plants
def test_each_actuators_speed_has_its_own_gain(exact, plant_name, within_rad) -> None:
    commands = swing(80, T)
    q = run(plant_name, exact, commands, speed_gain=GAINS[None])
    gain = np.concatenate([np.ones(3), GAINS])
    motion = motion_of(exact, commands, gain=gain)
    expected = np.array([motion(k * T)[0] for k in range(81)])
    assert q == pytest.approx(expected, abs=within_rad)
    plant = make_plant(plant_name, exact, 1, speed_gain=GAINS[None])
    _r, _q, v = steps(plant, start_of(), 60, [0, 0, 0, 0.5, 0.5, 0.5, 0.5])
    assert v[-1, 0, 3:] == pytest.approx(0.5 * GAINS, rel=2e-3)


def test_the_greatest_acceleration_is_that_of_the_limits_by_a_ratio(exact) -> None:
    for ratio in (0.4, 1.2):
        for plant_name, within_rad in PLANTS:
            with named(ratio, plant_name, within_rad):
                commands = full(20, exact)
                q = run(plant_name, exact, commands, acceleration_ratio=ratio)
                motion = motion_of(exact, commands, ratio=ratio)
                expected = np.array([motion(k * T)[0] for k in range(21)])
                assert q == pytest.approx(expected, abs=within_rad)
                # the first period is all limit
                assert np.abs(q[1, 3:]) == pytest.approx(0.5 * 120.0 * ratio * T**2, rel=0.03)


@pytest.mark.parametrize(
    ("gain", "falloff", "plant_name"), [(0.8, 0.8, "kinematic"), (1.5, 0.3, "mujoco")]
)
def test_torque_falls_with_speed_where_a_motor_speeds_up(exact, plant_name, falloff, gain) -> None:
    commands = full(14, exact)
    q, without = (
        run(plant_name, exact, commands, torque_falloff=one, speed_gain=gain)
        for one in (falloff, 0.0)
    )
    motion = motion_of(exact, commands, falloff=falloff, gain=gain)
    effect = np.abs(q - without).max()
    assert effect > 1.5e-3
    # MuJoCo's motors have the limit of the speed at the beginning of each quarter of a period
    within = 1e-8 if plant_name == "kinematic" else 0.25 * effect
    assert q == pytest.approx(np.array([motion(k * T)[0] for k in range(15)]), abs=within)


def test_a_motor_of_any_gain_and_falloff_reaches_its_speed_and_no_more(exact) -> None:
    for falloff in (0.0, 0.6):
        for plant_name in ("kinematic", "mujoco"):
            with named(falloff, plant_name):
                for gain in (0.5, 2.0):
                    options = {"speed_gain": gain, "torque_falloff": falloff}
                    plant = make_plant(plant_name, exact, 1, **options)
                    _r, _q, v = steps(plant, start_of(positions=-0.3), 14, [0, 0, 0, 1.5, 0, 0, 0])
                    assert (v[:, 0, 3] <= 1.5 * gain * (1 + 1e-3)).all()
                    assert v[-1, 0, 3] > 0.9 * 1.5 * gain


def test_the_limits_are_those_of_the_true_head(exact) -> None:
    for plant_name in ["kinematic", "mujoco"]:
        with named(plant_name):
            half = {n: 0.5 * getattr(exact.limits, n) for n in ("velocity", "acceleration")}
            ends = {"upper": np.full(7, 0.3), "lower": np.full(7, -0.3)}
            weak = exact.replace(limits=half | ends)
            plant = make_plant(plant_name, exact, 1, true_head=weak)
            command = np.array([0, 0, 0, 6.0, 6.0, 6.0, 6.0])
            readings, q, v = steps(plant, start_of(), 60, command)
            assert readings[-1].command[0, 3:] == pytest.approx(np.full(4, 3.0))
            assert v[1, 0, 3:] == pytest.approx(np.full(4, 60.0 * T), rel=0.03)
            assert np.abs(v[:, 0]).max() <= 3.0 * (1 + 1e-3)
            assert q[-1, 0, 3:] == pytest.approx(np.full(4, 0.3), abs=5e-3)
