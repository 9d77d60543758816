"""`vergence train`: gain schedules and policies, learned from trials."""

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from vergence.commands.console import note
from vergence.commands.extras import require
from vergence.errors import ConfigurationError

if TYPE_CHECKING:
    from vergence.models.head import HeadModel
    from vergence.training.config import TrainConfig
    from vergence.training.run import Result
    from vergence.training.validation import Score


@dataclass(frozen=True, kw_only=True)
class Train:
    """Learn a gain schedule or a policy; write a run folder that can go on after a kill."""

    kind: Annotated[
        Literal["gain-schedule", "policy"] | None,
        tyro.conf.Positional,
        tyro.conf.arg(metavar="KIND"),
    ] = None
    """gain-schedule (learns the gains of the article's law) or policy (joint velocities)."""
    algo: Literal["ppo", "sac"] = "ppo"
    """Algorithm."""
    head: str | None = None
    """Head: a preset's name or the path of a TOML file; the scenario's by default."""
    scenario: str = "workspace"
    """Scenario whose training trials it learns from (see `vergence info`)."""
    plant: str = "kinematic"
    """What moves the heads: kinematic or mujoco."""
    seed: int = 0
    """Seed of everything."""
    steps: int | None = None
    """Control steps to learn from, over all environments; the recipe's by default."""
    envs: int | None = None
    """Environments side by side; the recipe's by default."""
    inputs: str | None = None
    """What the network sees (see docs/training.md); the recipe's by default."""
    randomise: bool = False
    """Learn with the hidden delays, lags, noise and model errors of scenario robust."""
    set: Annotated[tuple[str, ...], tyro.conf.arg(metavar="FIELD=VALUE")] = ()
    """Changes of the recipe, such as network=[64,64] algorithm.learning_rate=1e-3."""
    out: Path | None = None
    """Run folder, new or empty; runs/train-KIND-DATE-TIME by default."""
    resume: Annotated[Path | None, tyro.conf.arg(metavar="RUN")] = None
    """Go on with the run in this folder, to --steps or to what it was begun with."""

    def run(self) -> int:
        """Run the command."""
        require("train", "torch", "stable_baselines3", "tensorboard")
        from vergence.training.run import resume, train

        if self.resume is not None:
            self._check_nothing_else()
            with _watching(self.resume) as watch:
                return _end(resume(self.resume, watch, steps=self.steps))
        config, head = self.choices()
        folder = self.out or Path("runs") / f"train-{self.kind}-{datetime.now():%Y%m%d-%H%M%S-%f}"
        with _watching(folder) as watch:
            return _end(train(folder, config, head, watch))

    def choices(self) -> "tuple[TrainConfig, HeadModel]":
        """The run's configuration and head, with everything resolved.

        Raises:
            VergenceError: there is no kind, a name is unknown or a value cannot be.
        """
        from vergence.training.choices import choose

        if self.kind is None:
            raise ConfigurationError(
                "train: expected gain-schedule or policy, or --resume RUN, got neither"
            )
        return choose(
            self.kind,
            algo=self.algo,
            head=self.head,
            scenario=self.scenario,
            plant=self.plant,
            seed=self.seed,
            steps=self.steps,
            envs=self.envs,
            inputs=self.inputs,
            randomise=self.randomise,
            changes=self.set,
        )

    def _check_nothing_else(self) -> None:
        """A run goes on as it was begun."""
        for field in fields(self):
            if field.name not in ("resume", "steps") and getattr(self, field.name) != field.default:
                raise ConfigurationError(
                    f"{field.name}: expected nothing beside --resume but --steps, "
                    f"got {getattr(self, field.name)}"
                )


class _Watch:
    """A bar with the newest evaluation on a terminal, a line for each elsewhere."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._console = Console(stderr=True, highlight=False)
        self.bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.fields[state]}"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=self._console,
        )
        self._task = self.bar.add_task("training", total=None, state="")
        self._unit = ""
        self.stop = False

    def begin(self, baselines: "dict[str, Score]", unit: str) -> None:
        """See `Listener.begin`."""
        self._unit = unit
        if self._console.is_terminal:
            self.bar.start()
        else:
            said = ", ".join(f"{name} {b.headline:.3f} {unit}" for name, b in baselines.items())
            print(f"{self._folder}: to beat on validation trials: {said}", file=sys.stderr)

    def step(self, done: int, total: int) -> None:
        """See `Listener.step`."""
        self.bar.update(self._task, completed=done, total=total)

    def row(self, row: dict[str, Any]) -> None:
        """See `Listener.row`."""
        state = (
            f"{row['headline']:.3f} {self._unit}, {row['gain']:.2f} times better than tuned, "
            f"{row['settled_fraction']:.1%} good, {row['steps_per_s']} steps/s"
        )
        self.bar.update(self._task, state=state)
        if not self._console.is_terminal:
            print(f"{row['step']} steps: {state}", file=sys.stderr, flush=True)

    def stopping(self) -> bool:
        """See `Listener.stopping`."""
        return self.stop


@contextmanager
def _watching(folder: Path) -> Iterator[_Watch]:
    """A watch; the first Ctrl-C asks the run to be saved and left, the second ends it at once."""
    watch = _Watch(folder)

    def interrupt(_number: int, _frame: object) -> None:
        watch.stop = True
        signal.signal(signal.SIGINT, signal.default_int_handler)
        note("interrupted: saving after this update (again to stop at once)")

    before = signal.signal(signal.SIGINT, interrupt)
    try:
        yield watch
    except KeyboardInterrupt:
        note(f"interrupted: vergence train --resume {folder} goes on from the last checkpoint")
        raise SystemExit(130) from None
    finally:
        signal.signal(signal.SIGINT, before)
        if watch.bar.live.is_started:
            watch.bar.stop()


def _end(result: "Result") -> int:
    """Print how a run has ended."""
    if not result.finished:
        note(f"stopped after {result.steps} steps: vergence train --resume {result.folder} goes on")
        return 130
    console = Console(highlight=False)
    table = Table("controller", f"validation ({result.unit})", "mean", "good", "times better")
    for column in table.columns[1:]:
        column.justify = "right"
    baseline = min(score.headline for score in result.baselines.values())
    for name, score in result.baselines.items():
        table.add_row(
            name,
            f"{score.headline:.3f}",
            f"{score.mean:.3f}",
            f"{score.settled_fraction:.1%}",
            f"{baseline / score.headline:.2f}",
        )
    table.add_section()
    best = next(row for row in reversed(result.rows) if row["best"])
    for name, row in (("best", best), ("last", result.rows[-1])):
        table.add_row(
            f"{name}, at {row['step']} steps",
            f"{row['headline']:.3f}",
            f"{row['mean']:.3f}",
            f"{row['settled_fraction']:.1%}",
            f"{row['gain']:.2f}",
        )
    console.print(table)
    print(f"written to {result.folder}")
    return 0
