"""Plants keep the joints' limits and take commands of one shape."""

import numpy as np
import pytest

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
