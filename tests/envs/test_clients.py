"""Other people's learners make and train on the environment as on any of Gymnasium's."""

import subprocess
import sys

import pytest

pytestmark = [pytest.mark.nightly, pytest.mark.filterwarnings("ignore")]


def test_torchrl_makes_it_by_its_name() -> None:
    envs = pytest.importorskip("torchrl.envs", reason="TorchRL is not installed")
    env = envs.GymEnv("vergence/Gaze-v0", plant="kinematic")  # it tries a frameskip first
    envs.check_env_specs(env)
    assert env.rollout(5).shape == (5,)


RLLIB = """
import gymnasium, vergence
from ray.rllib.algorithms.ppo import PPOConfig
from ray.tune.registry import register_env
register_env("gaze", lambda _: gymnasium.make("vergence/Gaze-v0", plant="kinematic"))
config = PPOConfig().environment("gaze").env_runners(num_env_runners=0)
config = config.training(train_batch_size_per_learner=256, minibatch_size=128, num_epochs=1)
algorithm = config.build_algo()
assert algorithm.train()["env_runners"]["num_env_steps_sampled"] >= 256
algorithm.stop()
"""
"""A round of RLlib's PPO; in a process of its own, as Ray is one for a process."""


def test_rllibs_ppo_learns_on_it() -> None:
    for name in ("ray", "tree", "lz4", "ormsgpack", "pydantic"):
        pytest.importorskip(name, reason=f"RLlib needs {name}")
    done = subprocess.run(
        [sys.executable, "-c", RLLIB], capture_output=True, text=True, timeout=240, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
