"""Training runs small enough for tests."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from vergence.training import run
from vergence.training.choices import resolve_config
from vergence.training.config import TrainConfig
from vergence.training.curve import draw_curve
from vergence.training.listener import TrainingResult
from vergence.training.options import TrainOptions

SMALL = (
    "envs=8",
    "episode_steps=20",
    "network=[8]",
    "critic=[8]",
    "evaluations=4",
    "episodes=4",
)
PPO = ("algorithm.n_steps=16", "algorithm.batch_size=128", "algorithm.n_epochs=1")
STEPS = 8 * 16 * 4
"""Four rollouts."""


@contextmanager
def drawn() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "draw_curve", draw_curve)
        yield


class Silent:
    """A listener that keeps what it is told, and stops a run after some evaluations."""

    def __init__(self, stop_after: int | None = None) -> None:
        self.rows: list[dict[str, Any]] = []
        self.steps: list[tuple[int, int]] = []
        self._stop_after = stop_after

    def begin(self, baselines: dict[str, Any], unit: str) -> None:
        self.baselines = baselines
        self.unit = unit

    def resumed(self, done: int) -> None:
        self.went_on_from = done

    def step(self, done: int, total: int) -> None:
        self.steps.append((done, total))

    def row(self, row: dict[str, Any]) -> None:
        self.rows.append(row)

    def stopping(self) -> bool:
        return self._stop_after is not None and len(self.rows) >= self._stop_after


def small(kind: str = "gain-schedule", *changes: str, **words: Any) -> tuple[TrainConfig, Any]:
    words = {"steps": STEPS, **words}
    return resolve_config(TrainOptions(kind=kind, set=(*SMALL, *PPO, *changes), **words))


def run_small(
    folder: Path, *changes: str, kind: str = "gain-schedule", **words: Any
) -> TrainingResult:
    return run.train(folder, *small(kind, *changes, **words), Silent())
