"""Train Stable-Baselines3 on the task, with the recipe of the docs and with its defaults.

Run ``python benchmarks/stable_baselines.py --csv docs/results/stable_baselines.csv``: some forty
minutes on one core. Every training is evaluated on 1,000 unseen trials, on the plant that it was
trained on. See ``docs/stable-baselines3.md``.
"""

import argparse
import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import pandas as pd
import torch
from gymnasium.vector import AutoresetMode
from rich.console import Console
from rich.table import Table
from stable_baselines3 import PPO

from vergence.training.vec_env import VectorEnvAdapter

RECIPE = Path(__file__).resolve().parents[1] / "docs" / "examples" / "learn_to_gaze.py"


def defaults(steps: int, seed: int) -> PPO:
    """Train PPO with all defaults, on one head on MuJoCo."""
    return PPO("MlpPolicy", gymnasium.make("vergence/Gaze-v0"), seed=seed).learn(steps)


def defaults_on_many_heads(steps: int, seed: int) -> PPO:
    """Train PPO as in the example of the adapter in ``docs/training.md``."""
    envs = gymnasium.make_vec(
        "vergence/Gaze-v0",
        num_envs=256,
        plant="kinematic",
        autoreset_mode=AutoresetMode.SAME_STEP,
    )
    adapted = VectorEnvAdapter(envs, seed=seed)
    return PPO("MlpPolicy", adapted, n_steps=64, batch_size=4096, seed=seed).learn(steps)


def main(arguments: list[str] | None = None) -> None:
    """Train, evaluate and print."""
    recipe = runpy.run_path(str(RECIPE))
    ways: dict[str, tuple[Callable[[int, int], PPO], int, str]] = {
        "recipe": (recipe["learn"], 500_000, "kinematic"),
        "defaults": (defaults, 200_000, "mujoco"),
        "defaults, 256 heads": (defaults_on_many_heads, 1_000_000, "kinematic"),
    }
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--csv", type=Path, help="where to keep the table")
    parser.add_argument("--ways", nargs="+", choices=ways, default=list(ways))
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--steps", type=int, help="fewer, for a short look")
    parser.add_argument("--trials", type=int, default=1000)
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)  # as in the recipe
    rows: list[dict[str, Any]] = []
    for way in options.ways:
        learn, steps, plant = ways[way]
        for seed in options.seeds:
            model = learn(options.steps or steps, seed)
            lost, error_px = recipe["judge"](model, options.trials, plant=plant)
            rows.append(
                {
                    "way": way,
                    "seed": seed,
                    "plant": plant,
                    "steps": model.num_timesteps,
                    "lost_fraction": lost,
                    "error_median_px": error_px,
                }
            )
            if options.csv is not None:
                pd.DataFrame(rows).to_csv(options.csv, index=False, float_format="%.6g")
    table = Table(title=f"PPO, judged on {options.trials} trials", title_justify="left")
    for column in rows[0]:
        table.add_column(column)
    for row in rows:
        table.add_row(*(f"{x:.4g}" if isinstance(x, float) else f"{x}" for x in row.values()))
    Console().print(table)


if __name__ == "__main__":
    main()
