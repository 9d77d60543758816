"""Names of the experiments, and the options of `vergence reproduce`; quick to import."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import tyro


@dataclass(frozen=True, kw_only=True)
class ReproduceConfig:
    """Experiments to run, their settings and the run folder."""

    experiments: Annotated[
        tuple[str, ...],
        tyro.conf.Positional,
        tyro.conf.arg(help_behavior_hint="", metavar="[EXPERIMENT...]"),
    ] = ()
    """Experiments (see `vergence info`); all by default."""
    out: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="PATH")] = None
    """Run folder, new or of an earlier call; runs/reproduce (or -quick) by default."""
    seed: int = 0
    """Seed of all experiments."""
    quick: bool = False
    """Fewer points, heads and repetitions; takes about two minutes."""
    config: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="FILE")] = None
    """TOML file with a table per experiment of changes to its configuration."""
    set: Annotated[
        tuple[str, ...], tyro.conf.arg(help_behavior_hint="", metavar="EXPERIMENT.FIELD=VALUE")
    ] = ()
    """Changes to configurations; they override those of --config."""
    include: Annotated[tuple[Path, ...], tyro.conf.arg(help_behavior_hint="")] = ()
    """Run folders of vergence evaluate to show in the report, after the experiments."""

    @property
    def folder(self) -> Path:
        """The run folder; experiments finished there with the same config and seed are kept."""
        return self.out or Path("runs") / ("reproduce-quick" if self.quick else "reproduce")


EXPERIMENTS: Final[dict[str, str]] = {
    "simulated-static": "vergence.eval.article.simulated_static:EXPERIMENT",
    "simulated-moving": "vergence.eval.article.simulated_moving:EXPERIMENT",
    "physical-static": "vergence.eval.article.physical_static:EXPERIMENT",
    "physical-moving": "vergence.eval.article.physical_moving:EXPERIMENT",
    "fixed-pair": "vergence.eval.article.fixed_pair:EXPERIMENT",
    "gain-sweep": "vergence.eval.article.gain_sweep:EXPERIMENT",
    "time-response": "vergence.eval.article.time_response:EXPERIMENT",
    "uncertainty": "vergence.eval.article.uncertainty:EXPERIMENT",
    "head-eye": "vergence.eval.article.head_eye:EXPERIMENT",
}
"""Entry points, `module:attribute`, of the experiments by name, in the article's order."""
