"""Configuration of tuning; also the options of `vergence tune`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import tyro

LEARNED: Final = ("gain-schedule", "policy")
"""Kinds of training, whose recipes can be tuned like the options of controllers."""


@dataclass(frozen=True, kw_only=True)
class TuneConfig:
    """The options to tune, and the search."""

    controller: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="CONTROLLER")]
    """Controller (see `vergence info`), or gain-schedule or policy to tune their training."""
    scenario: Annotated[str, tyro.conf.arg(metavar="SCENARIO")] = "workspace"
    """Scenario whose training trials judge each point (see `vergence info`)."""
    trials: int = 100
    """Total number of points to try, including those of earlier calls; ignored for a grid."""
    episodes: int = 400
    """Number of the scenario's trials that judge each point."""
    grid: bool = False
    """Try every point of the search's grid; the default for a single option with a step."""
    steps: Annotated[int | None, tyro.conf.arg(metavar="INT")] = 300_000
    """Control steps of each training; only for gain-schedule and policy."""
    head: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="HEAD")] = None
    """Head: a preset's name or the path of a TOML file; the scenario's by default."""
    plant: Annotated[str, tyro.conf.arg(metavar="PLANT")] = "kinematic"
    """Plant that moves the heads."""
    seed: int = 0
    """Seed of the trials and of the search."""
    storage: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="FILE|URL")] = None
    """Storage of the study: a SQLite file, or postgresql://USER:PASSWORD@HOST/DATABASE, which
    several machines may share; study.db in the run folder by default."""
    study: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="NAME")] = None
    """Name of the study; CONTROLLER-SCENARIO by default."""

    @property
    def learned(self) -> bool:
        """True if a kind of training is tuned."""
        return self.controller in LEARNED

    @property
    def name(self) -> str:
        """The study's name."""
        return self.study or f"{self.controller}-{self.scenario}"

    def storage_in(self, folder: Path) -> str:
        """Storage of the study of a run."""
        return self.storage or str(folder / "study.db")
