"""PPO of Stable-Baselines3 learns to look at a target from the raw observation: copy and change.

Run ``python learn_to_gaze.py --seed 0``: minutes on one core. It needs
``pip install 'vergence[train]'``.
"""

import argparse

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

import vergence  # noqa: F401  registers the environments
from vergence.training.vec_env import VectorEnvAdapter


def learn(steps: int = 500_000, seed: int = 0) -> PPO:
    """Learn from 64 heads side by side."""
    envs = gymnasium.make_vec(
        "vergence/Gaze-v0",
        num_envs=64,
        plant="kinematic",
        autoreset_mode=AutoresetMode.SAME_STEP,  # as Stable-Baselines3 does it
    )
    adapted = VectorEnvAdapter(envs, seed=seed)
    gamma = 0.97  # looks 33 steps ahead: the delay and a saccade take about as long
    model = PPO(
        "MlpPolicy",
        VecNormalize(adapted, norm_obs=False, gamma=gamma),  # scales rewards, nothing else
        n_steps=64,
        batch_size=256,
        gamma=gamma,
        learning_rate=lambda left: 1e-3 * left,  # falls to 0: the last updates are fine ones
        policy_kwargs={"log_std_init": -1.0},  # explores at a third of full speed, not at all of it
        seed=seed,
    )
    return model.learn(steps)


def judge(model: PPO, trials: int = 1000, plant: str = "kinematic") -> tuple[float, float]:
    """The share of trials that lose the target, and the median error at the end of one, px.

    The trials are none that it learned from. An error is the greater one of both eyes, without
    noise; that of a lost trial is infinite.
    """
    envs = gymnasium.make_vec("vergence/Gaze-v0", num_envs=trials, plant=plant, info=("truth",))
    observation, info = envs.reset(seed=1_000_000)
    lost = np.zeros(trials, dtype=bool)
    ended = np.zeros(trials, dtype=bool)
    while not ended.all():
        action, _state = model.predict(observation, deterministic=True)
        observation, _reward, terminated, truncated, info = envs.step(action)
        lost |= terminated
        ended = lost | truncated
    error = np.linalg.norm(info["truth"]["pixel_error"], axis=-1).max(axis=-1)
    envs.close()
    return float(lost.mean()), float(np.median(np.where(lost, np.inf, error)))


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--steps", type=int, default=500_000)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    torch.set_num_threads(1)  # more are slower for so small a network
    share, error_px = judge(learn(chosen.steps, chosen.seed))
    print(f"{share:.1%} of the trials lost, median error at the end {error_px:.2f} px")
