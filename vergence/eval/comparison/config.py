"""Configuration of an evaluation; also the options of `vergence evaluate`."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final

import tyro

ROBOT: Final = "hardware"
"""The plant of robots."""


@dataclass(frozen=True, kw_only=True)
class EvaluateConfig:
    """The controllers to compare, their trials and their heads."""

    controllers: Annotated[
        tuple[str, ...],
        tyro.conf.Positional,
        tyro.conf.arg(help_behavior_hint="", metavar="[CONTROLLER...]"),
    ] = ()
    """Controllers: names (see `vergence info`), .vgp bundles, .onnx files, module:class or
    path/to/file.py:class; all names by default. ibvs-tuned always runs too, except with
    --margins: the others are compared with it."""
    scenarios: Annotated[
        tuple[str, ...] | None,
        tyro.conf.arg(help_behavior_hint="", name="scenario", metavar="SCENARIO..."),
    ] = None
    """Scenarios (see `vergence info`); workspace by default, webcam with --config."""
    plants: Annotated[tuple[str, ...], tyro.conf.arg(name="plant", metavar="PLANT...")] = (
        "kinematic",
    )
    """Plants that move the heads and take the images: kinematic, mujoco, rendered, module:class
    of a custom simulation, or hardware for the robot of --config."""
    episodes: Annotated[
        int | None, tyro.conf.arg(help_behavior_hint="", aliases=("--trials",), metavar="INT")
    ] = None
    """Trials of each controller in each scenario, 1000 by default, 20 with --plant hardware; with
    --margins, trials at each value, 200 by default."""
    seed: int = 0
    """Index of the test seed."""
    head: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="HEAD")] = None
    """Head that replaces the scenarios' heads: a preset's name or the path of a TOML file."""
    options: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="FILE")] = None
    """TOML file of options in tables [controller] and [controller.scenario]; they override tuned
    options."""
    tune: bool = False
    """Tune ibvs-tuned first in scenarios where it is untuned for the head, and keep its gain."""

    hardware: Annotated[
        Path | None, tyro.conf.arg(help_behavior_hint="", name="config", metavar="PATH")
    ] = None
    """TOML file that describes a robot (see docs/robot.md): its head replaces the scenarios'
    heads, and its loop, as measured by vergence measure-delay, replaces their loops."""
    stage: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="STAGE")] = None
    """Means of placing targets before a robot: emulator, places (tags, [[places]] of its file),
    hand (a person moves the target and presses Enter) or still; by default the first one that is
    available."""

    default_trials: ClassVar[int] = 1000
    robot_trials: ClassVar[int] = 20

    @property
    def on_robot(self) -> bool:
        """True if any trial runs on a robot."""
        return ROBOT in self.plants

    @property
    def chosen_scenarios(self) -> tuple[str, ...]:
        """The scenarios; by default `workspace`, or `webcam` for a robot."""
        default = "workspace" if self.hardware is None else "webcam"
        return (default,) if self.scenarios is None else self.scenarios

    @property
    def trials(self) -> int:
        """Trials of each controller in each scenario."""
        default = self.robot_trials if self.on_robot else self.default_trials
        return default if self.episodes is None else self.episodes

    def resolved(self) -> dict[str, Any]:
        """The fields by name, with defaults filled in."""
        return {**asdict(self), "episodes": self.trials, "scenarios": self.chosen_scenarios}
