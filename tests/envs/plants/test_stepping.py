"""Heads that are stepped in one compiled call move as those that are stepped in parts."""

import numpy as np
import pytest

from vergence.envs.plants import threads
from vergence.envs.task import GazeTask
from vergence.eval.trials.scenarios import load_scenario


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


def states_of(heads: int, **options) -> dict[str, np.ndarray]:
    """All arrays of a batch after some steps, with new trials of a few heads in between."""
    rng, task = np.random.default_rng(0), GazeTask(heads, **options)
    seeds = np.arange(heads, dtype=np.uint64)
    task.begin(np.arange(heads), seeds, np.zeros(heads, np.uint64))
    for step in range(20):
        task.step(rng.uniform(-1.0, 1.0, (heads, task.layout.count)))
        if step == 10:
            some = np.arange(0, heads, 37)
            task.begin(some, seeds[some], np.ones(len(some), np.uint64))
    state = task.state()
    return {**state["task"], **state["plant"]}


@pytest.mark.parametrize(
    ("heads", "options"),
    [
        (400, {"plant": "kinematic"}),
        (50, {"plant": "mujoco"}),
        pytest.param(400, load_scenario("hardware").env_options(), marks=pytest.mark.slow),
        pytest.param(400, {"plant": "kinematic", "head": "icub"}, marks=pytest.mark.slow),
        pytest.param(50, {"plant": "mujoco", "head": "icub"}, marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_results_do_not_depend_on_the_number_of_threads(heads, options, monkeypatch):
    states = []
    for count in (1, 3):
        monkeypatch.setattr(threads, "processors", lambda count=count: count)
        states.append(states_of(heads, **options))
    assert len(threads.bounds(heads, 16)) == 4
    for name, array in states[0].items():
        np.testing.assert_array_equal(array, states[1][name], err_msg=name)
