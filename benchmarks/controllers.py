"""Measure the computing time of each controller, relative to the fixed-gain law in the same run.

Run ``python benchmarks/controllers.py``, with ``--json FILE`` to keep the table, ``--quick`` for a
short run, and bundles or networks (``.vgp``, ``.onnx``) to measure beside the registry. Every
controller gets the observations of the same trials of a scenario, in their order in time, for one
head and for a batch of 1,024 heads. The controllers take turns for several rounds, so that other
load of the machine affects all of them; the result of each is the median call of its best
round. See ``docs/evaluate.md``.
"""

import argparse
import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from vergence.envs.observation import ObservationLayout
from vergence.errors import VergenceError
from vergence.eval.comparison.contestants import BASELINE, make_contestants
from vergence.eval.trials.run import run_trials
from vergence.eval.trials.scenarios import load_scenario

HEADS = 1024
REFERENCE = BASELINE
"""Reference of the ratios: a law without a state, in one compiled kernel."""


@dataclass
class Case:
    """A controller to measure."""

    name: str
    controller: Any
    one_us: float = float("inf")
    """Time of `predict` for one head, microseconds."""
    batch_us: float = float("inf")
    """Time per head of `predict` for `HEADS` heads, microseconds."""

    def measure(self, observation: NDArray[np.float32], repeats: int) -> None:
        """Measure one more round."""
        self.one_us = min(self.one_us, self._median_us(observation[:, :1], repeats))
        self.batch_us = min(self.batch_us, self._median_us(observation, 1) / HEADS)

    def _median_us(self, observation: NDArray[np.float32], repeats: int) -> float:
        spent = []
        for _ in range(repeats):
            state, start = None, np.ones(observation.shape[1], dtype=np.bool_)
            for seen in observation:
                begun = time.perf_counter_ns()
                _, state = self.controller.predict(seen, state=state, episode_start=start)
                spent.append(time.perf_counter_ns() - begun)
                start = np.zeros_like(start)
        return float(np.median(spent)) / 1e3


def main(arguments: list[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("controllers", nargs="*", help="all of the registry by default")
    parser.add_argument("--json", type=Path, help="where to keep the table")
    parser.add_argument("--quick", action="store_true", help="one short round")
    options = parser.parse_args(arguments)
    scenario = load_scenario("workspace")
    head = scenario.model()
    layout = ObservationLayout.of(head)
    cases = []
    for one in make_contestants(tuple(options.controllers)):
        try:
            found = one.resolve_options(head, scenario.name)
            cases.append(Case(one.label, one.make(head, layout, found.options)[0]))
        except VergenceError as error:
            print(f"{one.label}: left out: {error}", file=sys.stderr)
    reference = next(case for case in cases if case.name == REFERENCE)
    trials = run_trials(
        reference.controller, scenario, episodes=HEADS, batch_size=HEADS, observed_trials=HEADS
    )
    observation = trials.observation[: 30 if options.quick else 120]
    for _ in range(1 if options.quick else 5):
        for case in cases:
            case.measure(observation, repeats=1 if options.quick else 4)
    rows = [
        {
            "name": case.name,
            "one_us": case.one_us,
            "batch_us": case.batch_us,
            "one_ratio": case.one_us / reference.one_us,
            "batch_ratio": case.batch_us / reference.batch_us,
        }
        for case in cases
    ]
    _print(rows)
    if options.json is not None:
        options.json.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")


def _print(rows: list[dict[str, Any]]) -> None:
    table = Table(title=f"predict on workspace; ratios to {REFERENCE}", title_justify="left")
    for column in ("controller", "one head (us)", "ratio", f"a head of {HEADS} (us)", "ratio"):
        table.add_column(column, justify="left" if column == "controller" else "right")
    for row in rows:
        table.add_row(
            row["name"],
            f"{row['one_us']:.1f}",
            f"{row['one_ratio']:.2f}",
            f"{row['batch_us']:.3f}",
            f"{row['batch_ratio']:.2f}",
        )
    Console().print(table)


if __name__ == "__main__":
    main()
