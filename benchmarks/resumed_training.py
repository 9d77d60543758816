"""Check that an interrupted and resumed training ends like an uninterrupted one.

Run ``python benchmarks/resumed_training.py --seeds 0 1 2 3 4``. Each seed is trained twice: once
without interruption, once stopped after a fraction of its steps and resumed. The table has the
headline metric of both on validation trials, and states if their networks are bitwise identical.
The exit code is 1 if any are not. See ``docs/training.md``.
"""

import argparse
import tempfile
from pathlib import Path
from typing import Any

import torch
from rich.console import Console
from rich.table import Table

from vergence.training.checkpoint import read_checkpoint
from vergence.training.choices import resolve_config
from vergence.training.listener import TrainingResult
from vergence.training.options import TrainOptions
from vergence.training.run import resume, train


class StopsAfter:
    """Listener that stops a run after a number of steps."""

    def __init__(self, steps: float = float("inf")) -> None:
        self._steps = steps
        self._done = 0

    def begin(self, baselines: Any, unit: str) -> None:
        """See `vergence.training.listener.TrainingListener`."""

    def resumed(self, done: int) -> None:
        """See `vergence.training.listener.TrainingListener`."""

    def step(self, done: int, total: int) -> None:
        """See `vergence.training.listener.TrainingListener`."""
        self._done = done

    def row(self, row: Any) -> None:
        """See `vergence.training.listener.TrainingListener`."""

    def stopping(self) -> bool:
        """See `vergence.training.listener.TrainingListener`."""
        return self._done >= self._steps


def network_of(result: TrainingResult) -> dict[str, torch.Tensor]:
    """Final weights of a run."""
    content = read_checkpoint(result.folder / "checkpoints" / "last.pt")
    policy: dict[str, torch.Tensor] = content["parameters"]["policy"]
    return policy


def same_network(ours: TrainingResult, theirs: TrainingResult) -> bool:
    """True if the final weights of two runs are bitwise identical."""
    mine, yours = network_of(ours), network_of(theirs)
    return set(mine) == set(yours) and all(torch.equal(mine[name], yours[name]) for name in mine)


def main(arguments: list[str] | None = None) -> int:
    """Train, and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--kind", default="gain-schedule", help="gain-schedule or policy")
    parser.add_argument("--steps", type=int, default=300_000, help="control steps of each run")
    parser.add_argument("--stop", type=float, default=1 / 3, help="share of them, then it stops")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    parser.add_argument("--set", nargs="*", default=[], help="see vergence train --set")
    options = parser.parse_args(arguments)
    table = Table("seed", "uninterrupted", "resumed", "stopped after", "same network")
    all_same = True
    for seed in options.seeds:
        choice = TrainOptions(
            kind=options.kind,
            seed=seed,
            steps=options.steps,
            set=tuple(options.set),
        )
        with tempfile.TemporaryDirectory() as folder:
            whole = train(Path(folder) / "whole", *resolve_config(choice), StopsAfter())
            parts = Path(folder) / "parts"
            part = train(parts, *resolve_config(choice), StopsAfter(options.stop * options.steps))
            resumed = resume(parts, StopsAfter())
            same = same_network(whole, resumed)
        all_same &= same
        ends = [f"{result.rows[-1]['headline']:.3f} {result.unit}" for result in (whole, resumed)]
        table.add_row(str(seed), *ends, f"{part.steps} steps", "yes" if same else "no")
    Console(highlight=False).print(table)
    return 0 if all_same else 1


if __name__ == "__main__":
    raise SystemExit(main())
