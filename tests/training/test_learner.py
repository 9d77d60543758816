"""A network in training acts in its environment as the controller that it becomes does."""

import numpy as np
import pytest

from tests.controllers.loops import begin
from vergence.controllers.networks.environments import GainScheduleTask, PolicyTask
from vergence.controllers.networks.inputs import Inputs
from vergence.controllers.networks.learned import NetworkController
from vergence.envs.task import GazeTask
from vergence.eval.trials.scenarios import load_scenario

TASKS = {"gain-schedule": GainScheduleTask, "policy": PolicyTask}


@pytest.mark.parametrize(("kind", "inputs"), [("gain-schedule", "to_go"), ("policy", "predicted")])
def test_the_environment_and_the_controller_act_alike_to_the_last_bit(kind, inputs) -> None:
    options = load_scenario("hardware").env_options()
    task, raw = TASKS[kind](6, inputs=inputs, **options), GazeTask(6, **options)
    weights = np.random.default_rng(0).normal(0.0, 0.2, (task.inputs.size, 4))

    def act(seen: np.ndarray) -> np.ndarray:
        return np.tanh(seen @ weights).astype(np.float32)

    controller = NetworkController(
        Inputs(inputs, raw.head, raw.layout), act, kind == "gain-schedule"
    )
    state = None
    begin(task, 3)
    begin(raw, 3)
    for _ in range(120):
        assert np.array_equal(task.encoded, raw.encoded)
        task.step(act(task.observation))
        action, state = controller.predict(raw.encoded, state)
        raw.step(action)
    assert np.abs(raw.encoded[:, raw.layout.fields["last_action"]]).max() > 0.05
