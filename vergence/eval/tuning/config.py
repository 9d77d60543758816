"""What is tuned, and how; also the options of `vergence tune`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import tyro

LEARNED: Final = ("gain-schedule", "policy")
"""Kinds of training, whose recipes can be tuned as the options of controllers can."""


@dataclass(frozen=True, kw_only=True)
class TuneConfig:
    """What to tune, and how."""

    controller: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="CONTROLLER")]
    """Controller (see `vergence info`), or gain-schedule or policy: how these are best trained."""
    scenario: Annotated[str, tyro.conf.arg(metavar="SCENARIO")] = "workspace"
    """Scenario whose training trials judge (see `vergence info`)."""
    trials: int = 100
    """Points to try in total, those of earlier calls included; a grid has its own number."""
    episodes: int = 400
    """Trials of the scenario that judge each point."""
    grid: bool = False
    """Try every point of the search's steps; the default where there is but one option."""
    steps: Annotated[int | None, tyro.conf.arg(metavar="INT")] = 300_000
    """Control steps of each training, of gain-schedule and policy."""
    head: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="HEAD")] = None
    """Head: a preset's name or the path of a TOML file; the scenario's by default."""
    plant: Annotated[str, tyro.conf.arg(metavar="PLANT")] = "kinematic"
    """What moves the heads."""
    seed: int = 0
    """Seed of the trials and of the search."""
    storage: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="FILE|URL")] = None
    """Where the study is kept: a SQLite file, or postgresql://USER:PASSWORD@HOST/DATABASE, which
    many machines may share; study.db in the run folder by default."""
    study: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="NAME")] = None
    """Name of the study; CONTROLLER-SCENARIO by default."""

    @property
    def learned(self) -> bool:
        """Whether what is tuned is a kind of training."""
        return self.controller in LEARNED

    @property
    def name(self) -> str:
        """The study's name."""
        return self.study or f"{self.controller}-{self.scenario}"

    def storage_in(self, folder: Path) -> str:
        """Where the study of a run is kept."""
        return self.storage or str(folder / "study.db")
