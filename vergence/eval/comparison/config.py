"""What an evaluation compares; also the options of `vergence evaluate`."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

import tyro


@dataclass(frozen=True, kw_only=True)
class EvaluateConfig:
    """What to compare, and how."""

    controllers: Annotated[
        tuple[str, ...],
        tyro.conf.Positional,
        tyro.conf.arg(help_behavior_hint="", metavar="[CONTROLLER...]"),
    ] = ()
    """Controllers: names (see `vergence info`), .vgp bundles, .onnx files, module:class or
    path/to/file.py:class; all names by default. ibvs-tuned always runs too, but with
    --margins: it is what the others are compared with."""
    scenarios: Annotated[tuple[str, ...], tyro.conf.arg(name="scenario", metavar="SCENARIO...")] = (
        "workspace",
    )
    """Scenarios (see `vergence info`)."""
    plants: Annotated[tuple[str, ...], tyro.conf.arg(name="plant", metavar="PLANT...")] = (
        "kinematic",
    )
    """What moves and sees: kinematic, mujoco, rendered, or module:class of a simulated one."""
    episodes: Annotated[
        int | None, tyro.conf.arg(help_behavior_hint="", aliases=("--trials",), metavar="INT")
    ] = None
    """Trials of each controller in each scenario, 1000 by default; with --margins at each value,
    200 by default."""
    seed: int = 0
    """Which of the test seeds."""
    head: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="HEAD")] = None
    """Head in place of the scenarios' own: a preset's name or the path of a TOML file."""
    options: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="FILE")] = None
    """TOML file of options, in tables [controller] and [controller.scenario]; over tuned ones."""
    tune: bool = False
    """Tune ibvs-tuned first where it is untuned for the head, and keep what is found."""

    default_trials: ClassVar[int] = 1000

    @property
    def trials(self) -> int:
        """Trials of each controller in each scenario."""
        return self.default_trials if self.episodes is None else self.episodes

    def resolved(self) -> dict[str, Any]:
        """What was run, by field, defaults filled in."""
        return {**asdict(self), "episodes": self.trials}
