"""The environment of a real head: what it refuses, and how long it lasts, without touching one."""

import gymnasium
import numpy as np
import pytest

import vergence
from tests.hardware.test_config import document, load
from vergence.errors import ConfigurationError, UnreadableFileError
from vergence.hardware import cameras, plant
from vergence.hardware.dynamixel.servos import DynamixelServos
from vergence.hardware.gaze import EPISODE_S, GazeHardwareEnv


@pytest.fixture
def config(tmp_path, monkeypatch):
    """A configuration of hardware that fails the test if it is opened."""

    def opened(*_words):
        pytest.fail("nothing may be opened before the first reset")

    monkeypatch.setattr(DynamixelServos, "open", opened)
    monkeypatch.setattr(cameras, "EyeThread", opened)
    return load(tmp_path, document())


def make(**options):
    return gymnasium.make("vergence/GazeHardware-v0", **options)


def test_it_needs_a_configuration():
    with pytest.raises(ConfigurationError, match="config: expected the path of a TOML file"):
        make()
    with pytest.raises(UnreadableFileError, match=r"none\.toml: No such file"):
        make(config="none.toml")


def test_the_plant_is_given_by_the_configuration(config):
    for option in ("plant", "plant_options"):
        with pytest.raises(ConfigurationError, match=f"{option}: expected none with config"):
            GazeHardwareEnv(config=config, **{option: {}})


def test_another_head_is_refused_and_the_same_one_taken(config):
    with pytest.raises(ConfigurationError, match=r"head: expected the head of .*robot\.toml"):
        make(config=config, head="physical")
    make(config=config, head="turrets").close()
    make(config=config.path, head=vergence.load_head("turrets")).close()


def test_spaces_and_plant_are_those_of_the_configured_head(config):
    with GazeHardwareEnv(config=config) as env:
        assert env.action_space.shape == (4,)
        assert env.task.head.digest == config.head.digest
        assert isinstance(env.task.plant, plant.HardwarePlant)
        assert env.task.plant.config is config


@pytest.fixture
def in_view(monkeypatch):
    """Robots on time, that always see the target straight ahead."""

    def reset(self, _ids, positions):
        self.reading.time_s[:] = 0.0
        self.reading.positions[:] = self.reading.positions_at_exposure[:] = positions
        return self.reading

    def step(self, _command):
        now = self.reading
        now.time_s[:] += self.head.timing.period_s
        now.frame[:] += 1
        now.exposure_s[:] = now.time_s - self.head.timing.latency_s
        now.received_s[:] = now.joints_s[:] = now.time_s
        now.pixels[:], now.visible[:] = self.head.cameras.principal, True
        return now

    for method in (reset, step):
        monkeypatch.setattr(plant.HardwarePlant, method.__name__, method)
    monkeypatch.setattr(plant.HardwarePlant, "prepare", lambda _self: None)


@pytest.mark.slow
@pytest.mark.parametrize(("options", "lasts_s"), [({}, EPISODE_S), ({"duration_s": 0.5}, 0.5)])
def test_an_episode_lasts_as_long_as_it_is_told(config, in_view, options, lasts_s):
    with GazeHardwareEnv(config=config, **options) as env:
        env.reset(seed=0)
        steps, over = 0, False
        while not over:
            _observation, _reward, lost, over, _info = env.step(np.zeros(4, np.float32))
            assert not lost
            steps += 1
        assert steps * env.task.head.timing.period_s == pytest.approx(lasts_s)


def test_a_length_that_is_none_is_refused(config):
    with pytest.raises(ConfigurationError, match="duration_s"):
        GazeHardwareEnv(config=config, duration_s=-1.0)
