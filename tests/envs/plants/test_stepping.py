"""Heads that are stepped in one compiled call move as those that are stepped in parts."""

import numpy as np
import pytest

from vergence.envs.task import GazeTask


@pytest.mark.parametrize("head", ["simulated", "turrets"])
def test_a_simulation_stepped_inside_is_that_of_the_batch_to_the_bit(head):
    rng, tasks = np.random.default_rng(0), [GazeTask(1, head=head) for _ in range(2)]
    assert tasks[1].plant._inside
    tasks[1].plant._inside = False
    for trial in range(2):
        for task in tasks:
            task.begin(np.arange(1), np.zeros(1, np.uint64), np.full(1, trial, np.uint64))
        for _ in range(30):
            action = rng.uniform(-1.0, 1.0, (1, tasks[0].layout.count))
            states = []
            for task in tasks:
                task.step(action)
                state = task.state()
                states.append({**state["task"], **state["plant"]})
            for name, array in states[0].items():
                np.testing.assert_array_equal(array, states[1][name], err_msg=name)
