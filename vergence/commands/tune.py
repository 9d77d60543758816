"""`vergence tune`: search for a controller's best options in a scenario."""

import shlex
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import tyro
from rich.console import Console

from vergence.commands.console import print_to_stderr, progress_bar
from vergence.commands.extras import require_modules
from vergence.commands.options import Flat, JobOptions, print_written
from vergence.commands.tables import print_table
from vergence.errors import ConfigurationError
from vergence.eval.tuning.spaces import TuneConfig

if TYPE_CHECKING:
    from vergence.controllers.tuned import TunedEntry
    from vergence.eval.trials.scenarios import Scenario
    from vergence.eval.tuning.tune import TuneResult
    from vergence.models.head import HeadModel

_PRINTED_POINTS: Final = 5
"""Number of best points that are printed (chosen: detail against length)."""


@dataclass(frozen=True, kw_only=True)
class Tune:
    """Search for the options with which a controller performs best; call again to continue."""

    config: Flat[TuneConfig]
    out: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="PATH")] = None
    """Run folder; runs/tune-CONTROLLER-SCENARIO by default. An earlier run in it is continued."""
    write: bool = False
    """Save the result in your own table of tuned options, for this head and scenario."""
    write_package: bool = False
    """For maintainers: save the result in the package's table; only for presets and the
    scenario's own head."""

    machines: Flat[JobOptions] = field(default_factory=JobOptions)

    def run(self) -> int:
        """Run the command."""
        require_modules("tune", "optuna")
        from vergence.controllers.tuned import write_tuned
        from vergence.envs.streams import as_seed
        from vergence.eval.trials.scenarios import load_scenario
        from vergence.eval.tuning.objective import controller_objective
        from vergence.eval.tuning.spaces import search_space
        from vergence.eval.tuning.tune import tune
        from vergence.models.head_file import load_head
        from vergence.reporting.runs import check_folder_free, run_folder_command

        config = self.config
        scenario = load_scenario(config.scenario)
        folder = self.out or Path("runs") / f"tune-{config.controller}-{config.scenario}"
        if folder.exists() and not folder.is_dir():
            raise ConfigurationError(f"out: expected a folder, got a file: {folder}")
        if run_folder_command(folder) not in ("tune", None):
            check_folder_free(folder)
        as_seed(config.seed)
        if config.episodes < 1:
            raise ConfigurationError(f"episodes: expected at least 1, got {config.episodes}")
        if config.steps is None or config.steps < 1:
            raise ConfigurationError(f"steps: expected at least 1, got {config.steps}")
        if config.learned:
            self._check_training()
        head = scenario.model() if config.head is None else load_head(config.head)
        # also refuses a plant on which the scenario cannot run
        scenario.env_options(plant=config.plant, head=head)
        self._check_tables(head, scenario)
        with self.machines.open_mapper() as mapper, progress_bar(f"tune {config.name}") as report:
            if config.learned:
                from vergence.training.tuning import RECIPE_SEARCH_RANGES, training_objective

                search_ranges, objective = RECIPE_SEARCH_RANGES, training_objective(config, folder)
            else:
                search_ranges = search_space(config.controller)
                objective = controller_objective(config, scenario, head, mapper)
            try:
                result = tune(
                    folder, config, search_ranges, objective, head, lambda n, of: report(n / of)
                )
            except KeyboardInterrupt:
                print_to_stderr(f"interrupted: the study stays in {folder}; call again to go on")
                return 130
        _print(result)
        for path in self._tables():
            write_tuned(path, self._entry(result, head))
            print(f"written to {path}")
        print_written(folder)
        return 0

    def _check_training(self) -> None:
        """Refuse options that cannot be combined with a kind of training."""
        require_modules("train", "torch", "stable_baselines3", "tensorboard")
        options = {"write": self.write, "write-package": self.write_package}
        for name, value in {**options, "cluster": self.machines.cluster}.items():
            if value:
                raise ConfigurationError(
                    f"{name}: expected a controller with options, got a kind of training"
                )

    def _tables(self) -> list[Path]:
        """Files of the tables to save the result in."""
        from vergence.controllers import tuned

        own = [tuned.user_table_path()] if self.write else []
        return own + ([tuned.TUNED_FILE] if self.write_package else [])

    def _check_tables(self, head: "HeadModel", scenario: "Scenario") -> None:
        """Refuse, before any work is done, tables that cannot take the result."""
        from vergence.controllers.tuned import check_table_writable, load_tuned
        from vergence.models.head_file import load_head, presets

        known = {load_head(name).digest for name in presets()} | {scenario.model().digest}
        if self.write_package and head.digest not in known:
            raise ConfigurationError(
                f"write-package: expected the scenario's own head or a preset "
                f"({', '.join(presets())}), got {head.name}; --write keeps the result in your own "
                "table"
            )
        for path in self._tables():
            if path.exists():
                load_tuned(path)
            check_table_writable(path)

    def _entry(self, result: "TuneResult", head: "HeadModel") -> "TunedEntry":
        """The result as an entry of a table."""
        from vergence.controllers.tuned import TunedEntry

        config = self.config
        options = result.best.options
        return TunedEntry(
            controller=config.controller,
            scenario=config.scenario,
            head=head.name,
            digest=head.digest,
            plant=config.plant,
            command=repeat_command(config, with_trials=not result.config.grid),
            seed=config.seed,
            options={name: float(f"{value:.6g}") for name, value in options.items()},
        )


def repeat_command(config: TuneConfig, *, with_trials: bool) -> str:
    """Command line that repeats a search, from any folder; a grid defines its number of points."""
    from vergence.models.head_file import absolute_source

    words = ["vergence", "tune", config.controller, "--scenario", config.scenario]
    if config.head is not None:
        words += ["--head", absolute_source(config.head)]
    if config.plant != TuneConfig.plant:
        words += ["--plant", config.plant]
    if config.grid:
        words += ["--grid"]
    if with_trials:
        words += ["--trials", str(config.trials)]
    words += ["--episodes", str(config.episodes), "--seed", str(config.seed)]
    return shlex.join(words)


def _print(result: "TuneResult") -> None:
    """Print the best points."""
    console = Console(highlight=False)
    shown = sorted(result.attempts, key=lambda attempt: attempt.rank)[:_PRINTED_POINTS]
    rows = [
        [f"headline ({result.metric_unit})", *(f"{a.results['headline']:z.4f}" for a in shown)],
        [f"mean ({result.metric_unit})", *(f"{a.results['mean']:z.4f}" for a in shown)],
        ["good", *(f"{a.results['settled_fraction']:.1%}" for a in shown)],
    ]
    rows += [[name, *(f"{a.options[name]:z.4g}" for a in shown)] for name in result.best.options]
    print_table(["attempt", *(str(attempt.number) for attempt in shown)], rows)
    best = ", ".join(f"{name} = {value:z.6g}" for name, value in result.best.options.items())
    console.print(f"best of {len(result.attempts)}: {best}")
