"""`vergence tune`: the options with which a controller does best in a scenario."""

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console
from rich.table import Table

from vergence.commands.console import note, progress
from vergence.commands.extras import require
from vergence.errors import ConfigurationError

if TYPE_CHECKING:
    from vergence.eval.tuning.tune import TuneConfig, TuneResult

_LEARNED = ("gain-schedule", "policy")
_SHOWN = 5
"""How many of the best points are printed."""


@dataclass(frozen=True, kw_only=True)
class Tune:
    """Search the options with which a controller does best; call again to go on."""

    controller: Annotated[str, tyro.conf.Positional]
    """Controller (see `vergence info`), or gain-schedule or policy: how these are best trained."""
    scenario: str = "workspace"
    """Scenario whose training trials judge (see `vergence info`)."""
    trials: int = 100
    """Points to try in total, those of earlier calls included; a grid has its own number."""
    episodes: int = 400
    """Trials of the scenario that judge each point."""
    grid: bool = False
    """Try every point of the search's steps; the default where there is but one option."""
    steps: int = 300_000
    """Control steps of each training, of gain-schedule and policy."""
    head: str | None = None
    """Head: a preset's name or the path of a TOML file; the scenario's by default."""
    plant: str = "kinematic"
    """What moves the heads."""
    seed: int = 0
    """Seed of the trials and of the search."""
    storage: Annotated[str | None, tyro.conf.arg(metavar="FILE|URL")] = None
    """Where the study is kept: a SQLite file, or postgresql://USER:PASSWORD@HOST/DATABASE, which
    many machines may share; study.db in the run folder by default."""
    study: str | None = None
    """Name of the study; CONTROLLER-SCENARIO by default."""
    out: Path | None = None
    """Run folder; runs/tune-CONTROLLER-SCENARIO by default, an earlier call's is gone on with."""
    write: bool = False
    """Put the result into the table of tuned options that ships with the package."""

    def run(self) -> int:
        """Run the command."""
        require("tune", "optuna")
        from vergence.envs.streams import as_seed
        from vergence.eval.trials.scenarios import load_scenario
        from vergence.eval.tuning.tune import (
            TuneConfig,
            controller_objective,
            is_grid,
            search_space,
            tune,
        )
        from vergence.models.files.head_file import load_head

        learned = self.controller in _LEARNED
        if learned and self.write:
            raise ConfigurationError(
                "write: expected a controller with options, got a kind of training"
            )
        scenario = load_scenario(self.scenario)
        name = f"{self.controller}-{self.scenario}"
        folder = self.out or Path("runs") / f"tune-{name}"
        if folder.exists() and not folder.is_dir():
            raise ConfigurationError(f"out: expected a folder, got a file: {folder}")
        if learned:
            require("train", "torch", "stable_baselines3", "tensorboard")
            from vergence.training.tuning import SPANS, training_objective

            spans = SPANS
        else:
            spans = search_space(self.controller)
        config = TuneConfig(
            controller=self.controller,
            scenario=self.scenario,
            head=self.head or scenario.head,
            plant=self.plant,
            trials=self.trials,
            episodes=self.episodes,
            seed=as_seed(self.seed),
            grid=self.grid or is_grid(spans),
            storage=self.storage or str(folder / "study.db"),
            study=self.study or name,
            steps=self.steps if learned else None,
        )
        if config.episodes < 1:
            raise ConfigurationError(f"episodes: expected at least 1, got {config.episodes}")
        if self.steps < 1:
            raise ConfigurationError(f"steps: expected at least 1, got {self.steps}")
        head = load_head(config.head)
        # also tells whether the scenario runs on that plant
        scenario.env_options(plant=config.plant, head=head)
        objective = (
            training_objective(config, folder)
            if learned
            else controller_objective(config, scenario, head)
        )
        with progress(f"tune {name}") as report:
            try:
                result = tune(folder, config, spans, objective, head, lambda n, of: report(n / of))
            except KeyboardInterrupt:
                note(f"interrupted: the study stays in {folder}; call again to go on")
                return 130
        _print(result)
        if self.write:
            self._write(config, result)
        print(f"written to {folder}")
        return 0

    def _write(self, config: "TuneConfig", result: "TuneResult") -> None:
        from vergence.controllers.tuned import TUNED_FILE, write_tuned

        words = ["vergence", "tune", config.controller, "--scenario", config.scenario]
        if not config.grid:
            words += ["--trials", str(config.trials)]
        words += ["--episodes", str(config.episodes), "--seed", str(config.seed)]
        options = {name: float(f"{value:.6g}") for name, value in result.best.options.items()}
        write_tuned(
            TUNED_FILE,
            config.controller,
            config.scenario,
            options,
            shlex.join(words),
            config.seed,
        )
        print(f"written to {TUNED_FILE}")


def _print(result: "TuneResult") -> None:
    """The best points."""
    console = Console(highlight=False)
    shown = sorted(result.attempts, key=lambda attempt: attempt.rank)[:_SHOWN]
    table = Table("attempt", *(str(attempt.number) for attempt in shown))
    for column in table.columns[1:]:
        column.justify = "right"
    table.add_row(
        f"headline ({result.unit})", *(f"{attempt.found['headline']:.4f}" for attempt in shown)
    )
    table.add_row(f"mean ({result.unit})", *(f"{a.found['mean']:.4f}" for a in shown))
    table.add_row("good", *(f"{attempt.found['settled_fraction']:.1%}" for attempt in shown))
    table.add_section()
    for name in result.best.options:
        table.add_row(name, *(f"{attempt.options[name]:.4g}" for attempt in shown))
    console.print(table)
    best = ", ".join(f"{name} = {value:.6g}" for name, value in result.best.options.items())
    console.print(f"best of {len(result.attempts)}: {best}")
