"""Configuration of a run of the experiments; also the options of `vergence reproduce`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

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
