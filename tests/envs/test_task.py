"""Arguments of a task, and the information that it returns."""

import numpy as np

from tests.controllers.loops import begin
from tests.naming import refused
from vergence import ModelErrors, load_head
from vergence.envs.plants.kinematic import KinematicPlant
from vergence.envs.reading import Reading
from vergence.envs.task import GazeTask
from vergence.errors import VergenceError


def test_model_errors_give_every_head_its_own_and_the_controller_none() -> None:
    errors = {"joint_offset_rad": 0.01}
    task = GazeTask(3, plant="kinematic", model_errors=errors, model_seed=4)
    assert task.head == load_head("simulated")
    offsets = task.plant.true_head.links.offset - task.head.links.offset
    assert len(np.unique(offsets[:, 3])) == 3
    same = GazeTask(3, plant="kinematic", model_errors=ModelErrors(**errors), model_seed=4)
    assert np.array_equal(same.plant.true_head.packed, task.plant.true_head.packed)
    other = GazeTask(3, plant="kinematic", model_errors=errors, model_seed=5)
    assert not np.array_equal(other.plant.true_head.packed, task.plant.true_head.packed)


class HalfSpeed(KinematicPlant):
    """Heads that are commanded by half of what they are told."""

    def step(self, command):
        return super().step(0.5 * command)


class Copying(KinematicPlant):
    """Heads whose first reading is a copy."""

    def begin(self, start):
        return Reading(*(array.copy() for array in super().begin(start)))


def test_a_plant_with_a_step_of_its_own_makes_it() -> None:
    half = begin(GazeTask(2, plant=f"{__name__}:HalfSpeed"))
    plain = begin(GazeTask(2, plant="kinematic"))
    for _ in range(12):
        half.step(np.full((2, 4), 1.0))
        plain.step(np.full((2, 4), 0.5))
    assert np.array_equal(half.truth().positions, plain.truth().positions)
    assert np.array_equal(half.reading.positions, plain.reading.positions)
    assert (half.command == 2.0 * plain.command).all()


def test_a_plant_that_returns_another_reading_is_judged_by_it() -> None:
    copying = begin(GazeTask(2, plant=f"{__name__}:Copying"))
    plain = begin(GazeTask(2, plant="kinematic"))
    for task in (copying, plain):
        assert task.reading.time_s.tolist() == [0.0, 0.0]
        task.step(np.full((2, 4), 1.0))
    assert np.array_equal(copying.reading.time_s, plain.reading.time_s)
    assert np.array_equal(copying.observation, plain.observation)


def test_info_on_request_has_truth_and_both_fixes() -> None:
    task = begin(GazeTask(2, plant="kinematic", info=("truth", "fixes")))
    for _ in range(12):
        task.step(np.zeros((2, 4)))
    info = task.info()
    assert np.array_equal(info["truth"]["target"], task.truth().target)
    gaze, views = task.fixes()
    assert np.array_equal(info["gaze"]["point"], gaze.point, equal_nan=True)
    # the eyes are still, so the image's fix is the target, up to 0.03 px: 2 mm at 1 m
    error = np.abs(info["itpc"]["point"] - task.truth().target)
    assert (error < 6 * views.sigma).all()
    assert set(begin(GazeTask(1, plant="kinematic")).info()) == {"is_success", "reward_terms"}


def test_arguments_that_cannot_be_are_refused_by_name() -> None:
    both = {"model_errors": {}, "plant_options": {"true_head": load_head("simulated")}}
    for options, message in [
        ({"plant": "wooden"}, "plant: expected one of hardware, kinematic, mujoco.*'wooden'"),
        ({"head": "nobody"}, "nobody"),
        ({"info": ("truht",)}, "info: expected some of fixes, truth, got 'truht'"),
        ({"model_errors": {"join_rad": 0.1}}, r"model_errors\.join_rad: expected one of link_m"),
        (both, "either model_errors or true_head"),
    ]:
        refused(message, GazeTask, 1, error=VergenceError, **options)
