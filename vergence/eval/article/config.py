"""Which experiments run, and how; also the options of `vergence reproduce`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True, kw_only=True)
class ReproduceConfig:
    """What to run, and how."""

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
    """Fewer points, heads and repetitions: a look in two minutes."""
    config: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="FILE")] = None
    """TOML file with a table per experiment that changes its configuration."""
    set: Annotated[
        tuple[str, ...], tyro.conf.arg(help_behavior_hint="", metavar="EXPERIMENT.FIELD=VALUE")
    ] = ()
    """Changes of configurations, over those of --config."""
    include: Annotated[tuple[Path, ...], tyro.conf.arg(help_behavior_hint="")] = ()
    """Run folders of vergence evaluate to show in the report, after the experiments."""

    @property
    def folder(self) -> Path:
        """The run folder; what is finished there for the same config and seed is kept."""
        return self.out or Path("runs") / ("reproduce-quick" if self.quick else "reproduce")
