"""Measure the returns of policies: losing the target must earn least, the best law most.

Run ``python benchmarks/returns.py``, with ``--csv docs/results/returns.csv`` to keep the table. A
row is a scenario and a policy: the fraction of trials that lose the target, and the mean return of
an episode of `MAX_EPISODE_STEPS` for each discount. See ``docs/environment.md``.
"""

import argparse
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from vergence.controllers.controller import make_controller
from vergence.envs import MAX_EPISODE_STEPS
from vergence.envs.task import Policy, rollout
from vergence.eval.trials.scenarios import Scenario, load_scenario
from vergence.models.head import HeadModel

DISCOUNTS = (1.0, 0.99, 0.97)


class FullSpeed:
    """Policy with all actuators at full speed; trials cycle through all combinations of signs."""

    def __init__(self, actuators: int) -> None:
        self._directions = np.array(list(itertools.product((-1.0, 1.0), repeat=actuators)))

    def predict(
        self,
        observation: NDArray[np.float32],
        state: Any = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[Any], Any]:
        """See `vergence.envs.task.Policy`."""
        which = np.arange(len(observation)) % len(self._directions)
        return self._directions[which], state


class Still(FullSpeed):
    """Policy that does not move."""

    def predict(self, *given: Any, **options: Any) -> tuple[NDArray[Any], Any]:
        """See `vergence.envs.task.Policy`."""
        action, state = super().predict(*given, **options)
        return 0.0 * action, state


def policies(head: HeadModel) -> dict[str, Policy]:
    """Policies in the expected order of their returns, lowest first."""
    return {
        "full speed": FullSpeed(head.actuation.count),
        "still": Still(head.actuation.count),
        "ibvs, half the gain": make_controller("ibvs", head=head, gain=2.05),
        "ibvs, tuned gain": make_controller("ibvs", head=head, gain=4.1),
        "saccade": make_controller("saccade", head=head),
    }


def returns(policy: Policy, scenario: Scenario, trials: int) -> dict[str, float]:
    """Fraction of lost trials, and mean return for each discount."""
    task = scenario.task(trials)
    total, going = np.zeros((len(DISCOUNTS), trials)), np.ones(trials, dtype=np.bool_)

    def earn(step: int) -> None:
        nonlocal going
        if step:
            discounted = np.power(DISCOUNTS, step - 1)[:, None] * task.reward
            total[:, going] += discounted[:, going]
            going = going & ~task.lost

    rollout(task, policy, MAX_EPISODE_STEPS, earn, seed=scenario.seed("test"))
    means = total.mean(axis=1)
    return {
        "lost": 1.0 - float(going.mean()),
        **{f"return_{g:g}": float(mean) for g, mean in zip(DISCOUNTS, means, strict=True)},
    }


def main(arguments: list[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--csv", type=Path, help="where to keep the table")
    parser.add_argument("--trials", type=int, default=1000)
    options = parser.parse_args(arguments)
    rows = []
    for name in ("workspace", "robust"):
        scenario = load_scenario(name)
        for label, policy in policies(scenario.model()).items():
            found = returns(policy, scenario, options.trials)
            rows.append({"scenario": name, "policy": label, **found})
    table = Table(title=f"mean return of {options.trials} trials by discount", title_justify="left")
    for column in ("scenario", "policy", "lost", *(f"{discount:g}" for discount in DISCOUNTS)):
        table.add_column(column)
    for row in rows:
        numbers = [f"{row[f'return_{discount:g}']:.1f}" for discount in DISCOUNTS]
        table.add_row(row["scenario"], row["policy"], f"{row['lost']:.1%}", *numbers)
    Console().print(table)
    if options.csv is not None:
        pd.DataFrame(rows).to_csv(options.csv, index=False, float_format="%.6g")


if __name__ == "__main__":
    main()
