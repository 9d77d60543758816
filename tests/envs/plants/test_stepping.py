"""Heads that are stepped in one compiled call move as those that are stepped in parts."""

from functools import partial

import numpy as np
import pytest

from vergence._jit import untyped_tuple
from vergence.envs.judging import JUDGE, LIMIT
from vergence.envs.plants import threads
from vergence.envs.plants.commands import store_commands
from vergence.envs.plants.kinematic import KinematicPlant, move_motors
from vergence.envs.plants.sensing import read_sensors, simulate_detections
from vergence.envs.plants.starting import expose_frames_before_start
from vergence.envs.plants.stepping import EXPOSE, MOVE, REPORT, STORE, WARM_UP
from vergence.envs.plants.track import (
    expose_on_trajectory,
    mean_substep_controls,
    read_mujoco_joints,
    start_trajectory,
)
from vergence.envs.reward import compute_step_result
from vergence.envs.task import GazeTask
from vergence.eval.trials.scenarios import SCENARIOS, load_scenario
from vergence.models.files.head_file import presets
from vergence.models.mujoco.model import SUBSTEPS

PLANTS, NUMS = ("kinematic", "mujoco"), (1, 3)
STEPS = 20
RESET_AFTER = 9
"""Step after which one head begins another trial (chosen: its frames are still on their way)."""


def advance_in_parts(plant, ids, phases):
    """Do what `SimulatedPlant._advance` does by calls of its kernels, one after the other."""
    task, scene, steps = plant._task, untyped_tuple(plant._scene), plant._scene.step
    packed, frames = untyped_tuple(plant._true_heads.packed), untyped_tuple(plant._frames)
    timing, keys = untyped_tuple(plant._timing), untyped_tuple(plant._streams.keys)
    motors, feedback = untyped_tuple(plant._motors), untyped_tuple(plant._feedback)
    exposures, reading = untyped_tuple(plant._exposures), untyped_tuple(plant.reading)
    if phases & LIMIT:
        task.action[ids] = np.clip(task.requested[ids], -1.0, 1.0)
        count = task.action.shape[1]
        task.command[ids, 3 : 3 + count] = task.action[ids] * task.action_limits[:count]
    if phases & STORE:
        states = plant._feedback.control_loop_states
        commands = untyped_tuple(plant._commands)
        store_commands(ids, task.command, commands, states, steps, plant.reading.command)
    if phases & MOVE:
        move = move_kinematic if isinstance(plant, KinematicPlant) else move_mujoco
        move(plant, ids, packed, scene, motors, frames, exposures)
        steps[ids] += 1
    if phases & EXPOSE:
        simulate_detections(ids, timing, packed, keys, scene, exposures, frames)
    while phases & WARM_UP and expose_frames_before_start(ids, packed, scene, frames, exposures):
        simulate_detections(ids, timing, packed, keys, scene, exposures, frames)
    if phases & REPORT:
        read_sensors(
            ids, timing, packed, keys, steps, motors, plant._coupling, feedback, frames, reading
        )
    if phases & JUDGE:
        compute_step_result(
            ids, task.head, task.scaling, untyped_tuple(task.time_limits), reading, task.action,
            untyped_tuple(task.progress), untyped_tuple(task.result), task.coupled_head,
        )  # fmt: skip
    return True


def move_kinematic(plant, ids, packed, scene, motors, frames, exposures):
    period_s, commands = plant.head.timing.period_s, untyped_tuple(plant._commands)
    move_motors(ids, period_s, packed, scene, motors, plant._coupling, commands, frames, exposures)


def move_mujoco(plant, ids, packed, scene, motors, frames, exposures):
    """Move the joints by the batch, whether or not the plant would step a simulation inside."""
    period_s, commands = plant.head.timing.period_s, untyped_tuple(plant._commands)
    track, count, steps = untyped_tuple(plant._track), plant._substeps, plant._scene.step
    start_trajectory(ids, scene, track)
    for k in range(count):
        mean_substep_controls(
            ids, k, count, period_s, packed, steps, commands, motors, plant._slots, plant._ctrl
        )
        if plant._forces_vary:
            plant._limit_forces()
        plant._batch.step(None, SUBSTEPS // count)
        read_mujoco_joints(
            ids, k, plant._qpos, plant._qvel, plant._half_step, plant._joints, plant.head.packed,
            packed, scene, motors, plant._coupling, track,
        )  # fmt: skip
    expose_on_trajectory(ids, period_s, packed, steps, frames, track, exposures)


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


def fused_and_in_parts(scenario, plant, head, num):
    """Two equal tasks, the second of which is stepped in parts."""
    tasks = tuple(load_scenario(scenario).task(num, plant, head) for _ in range(2))
    tasks[1].plant._advance = partial(advance_in_parts, tasks[1].plant)
    return tasks


def test_steps_equal_those_in_parts_after_targets_have_got_longer_motions():
    tasks = fused_and_in_parts("workspace", "kinematic", "simulated", 1)
    assert_steps_equal(tasks)
    longer = load_scenario("wander").task()
    longer.begin(np.arange(1), *np.zeros((2, 1), np.uint64))
    motions = longer.plant._scene.motions
    assert motions.shape[1] > tasks[0].plant._scene.motions.shape[1]
    for task in tasks:
        task.plant.move_targets(np.arange(1), motions)
    for _ in range(STEPS):
        for task in tasks:
            task.step(np.zeros((1, task.layout.count)))
        assert_equal_states(tasks)


@pytest.mark.parametrize("i", range(len(SCENARIOS)), ids=list(SCENARIOS).__getitem__)
def test_steps_of_every_scenario_equal_those_of_their_kernels(i):
    # each head meets each plant twice
    heads = sorted(presets())
    plant, head, num = PLANTS[i % 2], heads[i // 2 % len(heads)], NUMS[i // 4 % 2]
    assert_steps_equal(fused_and_in_parts(list(SCENARIOS)[i], plant, head, num))


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
        monkeypatch.setattr(threads, "processors", lambda count=count: count)
        states.append(states_of(heads, **options))
    assert len(threads.bounds(heads, 16)) == 4
    for name, array in states[0].items():
        np.testing.assert_array_equal(array, states[1][name], err_msg=name)
