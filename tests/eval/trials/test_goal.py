"""The goal of the eyes: the least error that the actuators of the true head can reach."""

import numpy as np
import pytest

from tests.envs.robot import WORLD
from tests.eval.trials.oracle import begin
from tests.heads import MOVING, head_of
from vergence.envs.task import GazeTask
from vergence.eval.trials.goal import least_reachable_error
from vergence.models.head import HeadModel

ERRORS = {"head_eye_rad": 0.005, "joint_offset_rad": 0.005, "focal_relative": 0.01}
TIED = [shape for shape in MOVING if not head_of(shape).actuation.direct]


def begun(head: HeadModel, num: int, **options: object) -> GazeTask:
    return begin(GazeTask(num, head=head, plant="kinematic", **options), 0)


def squares(task: GazeTask, actuators: np.ndarray) -> np.ndarray:
    """(n,) sums of both eyes' squared errors at the actuators' angles (n, 7), as measured."""
    simulation = task.plant
    q = task.head.actuation.joints_of(actuators)
    pixels = simulation.true_head.project(q, simulation.truth().target)
    error = task.head.undistort(pixels) - task.head.cameras.principal
    return np.sum(error**2, axis=(-2, -1))


def test_of_a_head_that_is_as_its_model_it_is_the_error_of_its_best_gaze():
    for shape in MOVING:
        task = begun(head_of(shape), 20)
        best = task.head.least_error(task.truth().target)
        found = least_reachable_error(task, task.truth().target)
        assert found == pytest.approx(best, abs=1e-6), shape


def test_no_other_angles_of_the_actuators_leave_less_of_a_true_head_s_error():
    rng = np.random.default_rng(0)
    for shape in TIED:
        task = begun(head_of(shape), 20, model_errors=ERRORS)
        least = np.sum(least_reachable_error(task, task.truth().target) ** 2, axis=(-2, -1))
        assert (least > 1e-4).all()  # the cameras are turned against each other
        actuation = task.head.actuation
        near = actuation.actuators_of(task.plant.true_head.fixate(task.truth().target))
        near[:, :3] = 0.0
        # about where the true head would look best if its cameras were known
        for scale in (0.03, 0.01, 0.003):
            for _ in range(50):
                tried = near.copy()
                tried[:, 3 : 3 + actuation.count] += scale * rng.standard_normal(actuation.count)
                assert (squares(task, tried) > least - 1e-9).all(), shape


def test_eyes_with_two_motors_each_have_no_least_error_but_zero():
    task = begun(head_of("panfirst"), 5, model_errors=ERRORS)
    assert not least_reachable_error(task, task.truth().target).any()


def test_where_no_simulation_tells_the_true_head_the_model_stands_for_it():
    head = head_of("mis")
    task = GazeTask(1, head=head, plant="tests.envs.robot:Emulated")
    found = least_reachable_error(task, np.array([WORLD]))
    assert np.abs(found).max() > 0.1
    assert found[0] == pytest.approx(head.least_error(WORLD), abs=1e-6)
