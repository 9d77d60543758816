"""`vergence tune`: the options with which a controller does best in a scenario."""

import shlex
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from vergence.commands.console import note, progress
from vergence.commands.extras import require
from vergence.commands.options import Flat, Machines
from vergence.commands.tables import print_table
from vergence.errors import ConfigurationError
from vergence.eval.tuning.config import TuneConfig

if TYPE_CHECKING:
    from vergence.eval.tuning.tune import TuneResult

_SHOWN = 5
"""How many of the best points are printed."""


@dataclass(frozen=True, kw_only=True)
class Tune:
    """Search the options with which a controller does best; call again to go on."""

    config: Flat[TuneConfig]
    out: Path | None = None
    """Run folder; runs/tune-CONTROLLER-SCENARIO by default, an earlier call's is gone on with."""
    write: bool = False
    """Put the result into the table of tuned options that ships with the package."""

    machines: Flat[Machines] = field(default_factory=Machines)

    def run(self) -> int:
        """Run the command."""
        require("tune", "optuna")
        from vergence.envs.streams import as_seed
        from vergence.eval.trials.scenarios import load_scenario
        from vergence.eval.tuning.spaces import search_space
        from vergence.eval.tuning.tune import controller_objective, tune
        from vergence.models.files.head_file import load_head

        config = self.config
        scenario = load_scenario(config.scenario)
        folder = self.out or Path("runs") / f"tune-{config.controller}-{config.scenario}"
        if folder.exists() and not folder.is_dir():
            raise ConfigurationError(f"out: expected a folder, got a file: {folder}")
        as_seed(config.seed)
        if config.episodes < 1:
            raise ConfigurationError(f"episodes: expected at least 1, got {config.episodes}")
        if config.steps is None or config.steps < 1:
            raise ConfigurationError(f"steps: expected at least 1, got {config.steps}")
        if config.learned:
            self._check_training()
        head = load_head(config.head or scenario.head)
        # also tells whether the scenario runs on that plant
        scenario.env_options(plant=config.plant, head=head)
        with self.machines.open_mapper() as mapper, progress(f"tune {config.name}") as report:
            if config.learned:
                from vergence.training.tuning import SPANS, training_objective

                spans, objective = SPANS, training_objective(config, folder)
            else:
                spans = search_space(config.controller)
                objective = controller_objective(config, scenario, head, mapper)
            try:
                result = tune(folder, config, spans, objective, head, lambda n, of: report(n / of))
            except KeyboardInterrupt:
                note(f"interrupted: the study stays in {folder}; call again to go on")
                return 130
        _print(result)
        if self.write:
            self._write(result)
        print(f"written to {folder}")
        return 0

    def _check_training(self) -> None:
        """What does not go together with a kind of training."""
        require("train", "torch", "stable_baselines3", "tensorboard")
        for name, value in (("write", self.write), ("cluster", self.machines.cluster)):
            if value:
                raise ConfigurationError(
                    f"{name}: expected a controller with options, got a kind of training"
                )

    def _write(self, result: "TuneResult") -> None:
        from vergence.controllers.tuned import TUNED_FILE, write_tuned

        config = result.config
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
    rows = [
        [f"headline ({result.unit})", *(f"{a.found['headline']:z.4f}" for a in shown)],
        [f"mean ({result.unit})", *(f"{a.found['mean']:z.4f}" for a in shown)],
        ["good", *(f"{a.found['settled_fraction']:.1%}" for a in shown)],
    ]
    rows += [[name, *(f"{a.options[name]:z.4g}" for a in shown)] for name in result.best.options]
    print_table(["attempt", *(str(attempt.number) for attempt in shown)], rows)
    best = ", ".join(f"{name} = {value:z.6g}" for name, value in result.best.options.items())
    console.print(f"best of {len(result.attempts)}: {best}")
