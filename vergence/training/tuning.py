"""Tune recipes by short training runs, judged on validation trials."""

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, cast

from vergence.eval.tuning.objective import Objective
from vergence.eval.tuning.spaces import Options, SearchRange, TuneConfig
from vergence.training.choices import resolve_config
from vergence.training.options import TrainingPlant, TrainOptions
from vergence.training.run import train

RECIPE_SEARCH_RANGES: Final = {
    "learning_rate": SearchRange(1e-4, 5e-3, "log"),
    "discount_time_steps": SearchRange(10.0, 200.0, "log"),
    "clip_range": SearchRange(0.1, 0.4),
    "gae_lambda": SearchRange(0.85, 0.99),
    "log_std_init": SearchRange(-2.0, 0.0),
}
"""Search ranges of a recipe's parameters; gamma = 1 - 1 / discount_time_steps."""


class _Silent:
    """A listener that does nothing."""

    def begin(self, baselines: Any, unit: str) -> None:
        """See `vergence.training.listener.TrainingListener`."""

    def resumed(self, done: int) -> None:
        """See `vergence.training.listener.TrainingListener`."""

    def step(self, done: int, total: int) -> None:
        """See `vergence.training.listener.TrainingListener`."""

    def row(self, row: Any) -> None:
        """See `vergence.training.listener.TrainingListener`."""

    def stopping(self) -> bool:
        """See `vergence.training.listener.TrainingListener`."""
        return False


def recipe_changes(options: Options) -> list[str]:
    """Convert a point of the search to changes of a recipe, see `vergence train --set`."""
    return [
        f"algorithm.learning_rate={options['learning_rate']!r}",
        f"algorithm.gamma={1.0 - 1.0 / options['discount_time_steps']!r}",
        f"algorithm.clip_range={options['clip_range']!r}",
        f"algorithm.gae_lambda={options['gae_lambda']!r}",
        f"log_std_init={options['log_std_init']!r}",
    ]


def training_objective(
    config: TuneConfig,
    folder: Path,
    changes: Callable[[Options], list[str]] = recipe_changes,
) -> Objective:
    """Make an objective that scores the last network of a short training on validation trials.

    Args:
        config: configuration of the tuning; its `controller` is the kind of training, its `steps`
            the length of each training.
        folder: folder for the trainings' files while they run.
        changes: converts a point of the search to changes of the recipe.
    """

    def judge(options: Options) -> dict[str, float]:
        choice, head = resolve_config(
            TrainOptions(
                kind=config.controller,
                head=config.head,
                scenario=config.scenario,
                plant=cast(TrainingPlant, config.plant),
                seed=config.seed,
                steps=config.steps,
                set=(*changes(options), "evaluations=1", f"episodes={config.episodes}"),
            )
        )
        with tempfile.TemporaryDirectory(prefix=".training-", dir=folder) as beside:
            row = train(Path(beside) / "run", choice, head, _Silent()).rows[-1]
        return {name: row[name] for name in ("headline", "mean", "settled_fraction")}

    return judge
