"""A rollout begins, acts, records, and closes the plant whatever happens."""

import numpy as np
import pytest

from tests.naming import named
from vergence.envs.plant import make_plant
from vergence.envs.task import GazeTask, rollout
from vergence.errors import ConfigurationError

TURN = np.array([0.0, 0.0, 0.0, 1.0, -1.0, 0.5, 0.5])


class Turns:
    """Turns the eyes, counts its calls in its state, and raises at one of them."""

    def __init__(self, error: BaseException | None = None, at: int = 5) -> None:
        self.error, self.at = error, at
        self.seen, self.starts = [], []

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        calls = 0 if state is None else state
        self.seen.append(observation)
        self.starts.append(episode_start.copy())
        if self.error is not None and calls == self.at:
            raise self.error
        return np.full((len(observation), 4), 0.4, np.float32), calls + 1


@pytest.fixture
def task():
    return GazeTask(2, plant="kinematic")


def at_rest(task: GazeTask) -> bool:
    truth = task.truth()
    return not truth.velocities.any() and not task.reading.command.any()


def test_record_is_called_at_time_zero_and_after_each_step(task):
    times = []
    rollout(task, Turns(), 4, lambda step: times.append((step, task.reading.time_s[0])))
    assert times == [(k, pytest.approx(k / 120.0)) for k in range(5)]


def test_the_policy_gets_each_observation_its_own_state_and_the_start_once(task):
    policy, encoded = Turns(), []
    rollout(task, policy, 5, lambda _step: encoded.append(task.observation.copy()))
    assert np.array_equal(policy.seen, encoded[:-1])
    assert policy.starts[0].all()
    assert not any(start.any() for start in policy.starts[1:])


def test_trials_are_those_of_the_seed_from_the_first_trial_on(task):
    targets = []
    rollout(task, Turns(), 1, lambda _step: targets.append(task.truth().target), seed=7)
    other, keep = GazeTask(1, plant="kinematic"), lambda _s: targets.append(other.truth().target)
    rollout(other, Turns(), 1, keep, seed=7, first_trial=1)
    assert np.array_equal(targets[0][1], targets[2][0])


def test_the_heads_are_at_rest_afterwards(task):
    moving = []
    rollout(task, Turns(), 12, lambda _step: moving.append(not at_rest(task)))
    assert moving[-1]
    assert at_rest(task)


def test_whatever_raises_the_plant_is_closed_and_the_heads_are_at_rest(task, monkeypatch):
    def full(step: int) -> None:
        if step == 6:
            assert not at_rest(task)
            raise OSError("no space left")

    closed, close = [], task.plant.close
    monkeypatch.setattr(task.plant, "close", lambda: (closed.append(True), close()))
    for policy, record, seed, error in (
        (Turns(KeyboardInterrupt()), lambda _step: None, 0, KeyboardInterrupt),
        (Turns(), full, 0, OSError),
        (Turns(), lambda _step: None, -1, ConfigurationError),
    ):
        with named(error), pytest.raises(error):
            rollout(task, policy, 20, record, seed=seed)
        assert closed.pop()
        assert at_rest(task)


def test_closing_brings_moving_joints_to_rest_where_they_are(simulated):
    for name in ["kinematic", "mujoco", "rendered"]:
        with named(name):
            plant = make_plant(name, simulated)
            plant.reset(np.arange(1), np.zeros((1, 7)))
            for _ in range(10):
                plant.step(TURN[None])
            before = plant.truth()
            assert np.abs(before.velocities).max() > 0.1
            plant.close()
            after = plant.truth()
            assert not after.velocities.any()
            assert np.array_equal(after.positions, before.positions)
            plant.close()
