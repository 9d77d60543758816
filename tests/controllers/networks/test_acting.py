"""Between a network's output and the command: outliers, steps, and nothing on an ideal head."""

import numpy as np
import pytest

from tests.controllers.loops import begin
from tests.grids import some_of
from tests.naming import named
from vergence import load_head
from vergence.controllers.networks.inputs import Inputs
from vergence.controllers.networks.learned import NetworkLoop
from vergence.envs.task import GazeTask
from vergence.eval.trials.scenarios import load_scenario

STEPPED = load_scenario("hardware").model()
"""The simulated head with steps of its commands."""
GAINS = np.full(4, np.sqrt(2.0) - 1.0)
"""Outputs of a schedule that ask for gains of 10 per second."""


def rows(acting: NetworkLoop, num: int) -> np.ndarray:
    return np.tile(acting.initial(), (num, 1))


def act(loop: NetworkLoop, encoded: np.ndarray, state: np.ndarray, outputs) -> np.ndarray:
    """The action of a network whose outputs are given, or made from its inputs."""
    seen = loop.inputs.layout.decode(encoded)
    inputs = loop.network_inputs(seen, state)
    outputs = outputs(inputs) if callable(outputs) else outputs
    return loop.inputs.layout.action(loop.command(seen, inputs, outputs, state))


def with_outlier(task: GazeTask, eye: int) -> np.ndarray:
    """The newest observations, one eye's detections 100 px aside."""
    seen = task.encoded.copy()
    coarse, fine = (task.layout.fields[name] for name in ("pixel_error", "pixel_error_fine"))
    width = task.head.cameras.size[eye, 0]
    seen[:, coarse.start + 2 * eye] += 100.0 / width
    seen[:, fine.start + 2 * eye] = np.sign(seen[:, coarse.start + 2 * eye])
    return seen


@pytest.mark.slow
def test_an_outlier_of_100_px_in_one_image_moves_no_schedule() -> None:
    for head in (load_head("simulated"), STEPPED):
        for kind in ("predicted", "to_go"):
            with named(kind, head):
                task = begin(GazeTask(20, head=head, plant="kinematic"), 3)
                acting = NetworkLoop(Inputs(kind, head), schedule=True)
                plain, other = rows(acting, 20), rows(acting, 20)
                for step in range(20):
                    image = with_outlier(task, eye=step % 2) if step == 15 else task.encoded
                    actions = []
                    for observation, state in ((task.encoded, plain), (image, other)):
                        actions.append(act(acting, observation, state, GAINS))
                    # the images before and after show the same, as the eyes rest; 100 px are 0.4
                    # of full speed
                    assert actions[1] == pytest.approx(actions[0], abs=0.02)
                    task.step(np.zeros((20, 4)))
                assert np.abs(actions[0]).max() > 0.05


def test_an_outlier_of_100_px_in_one_image_is_not_what_a_network_sees() -> None:
    """No channel of a turn changes by more than noise does: in the finest, by 10 mrad, 0.02 px."""
    head = load_head("simulated")
    task = begin(GazeTask(20, head=head, plant="kinematic"), 3)
    acting = NetworkLoop(Inputs("predicted", head), schedule=False)
    turns = [i for i, name in enumerate(acting.inputs.names) if name.startswith("asked")]
    assert turns
    plain, other = rows(acting, 20), rows(acting, 20)
    for step in range(20):
        image = with_outlier(task, eye=0) if step == 15 else task.encoded
        a = acting.network_inputs(task.layout.decode(task.encoded), plain)
        b = acting.network_inputs(task.layout.decode(image), other)
        assert b[:, turns] == pytest.approx(a[:, turns], abs=0.02)
        task.step(np.zeros((20, 4)))


def test_commands_are_whole_steps_and_on_average_what_was_asked_for() -> None:
    for share in [0.002, -0.011, 0.3]:
        with named(share):
            acting = NetworkLoop(Inputs("to_go", STEPPED), schedule=False)
            state, asked = rows(acting, 3), np.full((3, 4), share, dtype=np.float32)
            seen = np.ones((3, acting.inputs.size), dtype=np.float32)
            outputs = np.cbrt(asked)
            sent = np.array([acting.command(None, seen, outputs, state) for _ in range(400)])
            sent /= acting.inputs.layout.action_limits
            step = STEPPED.sensor.command_resolution_rad_s / acting.inputs.layout.action_limits
            steps = sent / step
            assert steps == pytest.approx(np.rint(steps), abs=1e-3)
            assert (np.abs(np.rint(steps)) != 1.0).all()
            # what is carried over at the end is a step and a half at most
            assert (np.abs(sent.mean(axis=0) - share) < 1.6 * step / 400).all()


def test_a_head_without_steps_takes_the_actions_as_they_are() -> None:
    acting = NetworkLoop(Inputs("to_go", load_head("simulated")), schedule=False)
    state = rows(acting, 5)
    share = np.random.default_rng(0).uniform(-1, 1, (5, 4)).astype(np.float32)
    seen = np.ones((5, acting.inputs.size), dtype=np.float32)
    command = acting.command(None, seen, np.cbrt(share), state)
    assert acting.inputs.layout.action(command) == pytest.approx(share, rel=1e-6)
    assert np.array_equal(state, rows(acting, 5), equal_nan=True)


def test_eyes_that_wait_for_their_target_do_not_creep() -> None:
    """Until an image shows it, whatever the network puts out."""
    for head, kind in some_of([load_head("simulated"), STEPPED], ["predicted", "to_go"]):
        with named(kind, head):
            late = {"onset_s": (0.2, 0.2)}
            task = begin(GazeTask(4, head=head, plant="kinematic", variation=late), 3)
            acting = NetworkLoop(Inputs(kind, head), schedule=False)
            state, asked = rows(acting, 4), np.full((4, 4), 0.5, dtype=np.float32)
            turned, visible = [], []
            for _ in range(60):
                turned.append(act(acting, task.encoded, state, asked).any())
                visible.append(task.reading.visible.any())
                task.step(np.zeros((4, 4)))
            first = visible.index(True)
            assert first > 20
            assert not any(turned[:first])
            assert turned[first]


@pytest.mark.parametrize("schedule", [False, True])
def test_one_head_is_a_row_of_a_batch(schedule) -> None:
    task = begin(GazeTask(4, head=STEPPED, plant="kinematic"), 3)
    acting = NetworkLoop(Inputs("predicted", STEPPED), schedule)
    many, one = rows(acting, 4), acting.initial()

    def outputs(inputs: np.ndarray) -> np.ndarray:
        return (
            np.broadcast_to(GAINS, (*inputs.shape[:-1], 4)) if schedule else 0.7 * inputs[..., :4]
        )

    for _ in range(30):
        action = act(acting, task.encoded, many, outputs)
        assert np.array_equal(act(acting, task.encoded[1], one, outputs), action[1])
        task.step(action)
    assert np.array_equal(many[1], one, equal_nan=True)
