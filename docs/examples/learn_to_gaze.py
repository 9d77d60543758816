"""PPO of Stable-Baselines3 learns to look at a target from the raw observation: copy and change.

Run ``python learn_to_gaze.py``: minutes on one core; ``--help`` lists the options. It needs
``pip install 'vergence[train]'``.
"""

import argparse
from pathlib import Path

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

import vergence
from vergence.training.vec_env import VectorEnvAdapter

ROBOT = {
    "latency_s": (0.05, 0.1),
    "lag_s": (0.02, 0.045),
    "command_latency_s": (0.0, 0.017),
    "feedback_latency_s": (0.0, 0.017),
    "frame_phase": (0.0, 1.0),
    "detection_noise_px": (0.0, 0.3),
    "acceleration_ratio": (0.4, 1.2),
}  # ranges of a loop like a robot's, from which each trial draws


def learn(steps: int = 500_000, seed: int = 0, **task) -> PPO:
    """Learn from 64 heads side by side."""
    envs = gymnasium.make_vec(
        "vergence/Gaze-v0",
        num_envs=64,
        autoreset_mode=AutoresetMode.SAME_STEP,  # as Stable-Baselines3 does it
        **{"plant": "kinematic", **task},
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
    return model.learn(steps, callback=show_progress)


def show_progress(variables: dict, _globals: dict) -> bool:
    """Print the mean return of the last 100 trials, every tenth rollout."""
    model = variables["self"]
    if model.num_timesteps % (10 * model.n_steps * model.n_envs) == 0:
        mean = np.mean([trial["r"] for trial in model.ep_info_buffer])
        print(f"{model.num_timesteps:,} steps: mean return {mean:.1f}", flush=True)
    return True


def judge(model: PPO, trials: int = 1000, **task) -> tuple[float, float]:
    """The share of trials that lose the target, and the median error at the end of one, px.

    The trials are none that it learned from. An error is the greater one of both eyes, without
    noise; that of a lost trial is infinite.
    """
    task = {"plant": "kinematic", "info": ("truth",), **task}
    envs = gymnasium.make_vec("vergence/Gaze-v0", num_envs=trials, **task)
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
    parser.add_argument("--head", default="simulated", help="a preset or a head file")
    parser.add_argument("--plant", default="kinematic", help="kinematic or mujoco")
    parser.add_argument("--robot", action="store_true", help="vary the loop like a robot's")
    parser.add_argument("--save", metavar="ZIP", help="keep the policy")
    chosen = parser.parse_args()
    torch.set_num_threads(1)  # more are slower for so small a network
    if chosen.save and not Path(chosen.save).absolute().parent.is_dir():
        parser.error(f"save: expected a folder that exists, got {chosen.save}")
    task = {"head": chosen.head, "plant": chosen.plant, "variation": ROBOT if chosen.robot else {}}
    try:
        model = learn(chosen.steps, chosen.seed, **task)
    except vergence.VergenceError as error:
        parser.exit(2, f"error: {error}\n")
    if chosen.save:
        model.save(chosen.save)
    share, error_px = judge(model, **task)
    print(f"{share:.1%} of the trials lost, median error at the end {error_px:.2f} px")
