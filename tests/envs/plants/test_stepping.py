"""One compiled call for many heads: in any number of threads, and MuJoCo inside as outside."""

import numpy as np
import pytest

from vergence.envs import plants
from vergence.envs.task import GazeTask
from vergence.eval.trials.scenarios import load_scenario

STEPS = 20
RESET_AFTER = 9
"""Step after which one head begins another trial (chosen: its frames are still on their way)."""


def assert_equal_states(tasks):
    one, other = ({**state["task"], **state["plant"]} for state in (t.state() for t in tasks))
    assert one.keys() == other.keys()
    for name, array in one.items():
        np.testing.assert_array_equal(array, other[name], err_msg=name)


def assert_steps_equal(tasks):
    """Begin trials of both tasks, step them by actions drawn at random, begin one trial anew."""
    rng, num = np.random.default_rng(0), tasks[0].num

    def begin(ids, trial):
        for task in tasks:
            task.begin(ids, np.full(len(ids), 7, np.uint64), np.full(len(ids), trial, np.uint64))
        assert_equal_states(tasks)

    for n in range(num):
        begin(np.array([n]), n)
    start = tasks[0].truth().positions
    for i in range(STEPS):
        action = rng.uniform(-1.5, 1.5, (num, tasks[0].layout.count))
        for task in tasks:
            task.step(action)
        assert_equal_states(tasks)
        if i == RESET_AFTER:
            assert (tasks[0].truth().positions != start).any(axis=1).all()
            begin(np.array([num - 1]), num)


@pytest.mark.parametrize("head", ["simulated", "turrets"])
def test_a_simulation_stepped_inside_is_that_of_the_batch_to_the_bit(head):
    tasks = [GazeTask(1, head=head) for _ in range(2)]
    assert tasks[1].plant._inside
    tasks[1].plant._inside, tasks[1].plant._kept_table = False, None
    assert_steps_equal(tasks)


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
        (80, {"plant": "kinematic"}),
        (80, load_scenario("hardware").env_options()),
        (50, {"plant": "mujoco", "head": "icub"}),
    ],
    ids=str,
)
def test_results_do_not_depend_on_the_number_of_threads(heads, options, monkeypatch):
    states = []
    for count in (1, 3):
        monkeypatch.setattr(plants, "processors", lambda count=count: count)
        states.append(states_of(heads, **options))
    assert len(plants.bounds(heads, 16)) == 4
    for name, array in states[0].items():
        np.testing.assert_array_equal(array, states[1][name], err_msg=name)
