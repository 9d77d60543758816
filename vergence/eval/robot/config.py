"""A deployment of a policy on a robot, and a replay; also the options of their commands."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True, kw_only=True)
class DeployConfig:
    """A policy on a robot."""

    controller: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="CONTROLLER_OR_BUNDLE")]
    """Controller: a name (see `vergence info`), a .vgp bundle, an .onnx file, module:class or
    path/to/file.py:class."""
    hardware: Annotated[Path, tyro.conf.arg(name="config", metavar="PATH")]
    """TOML file that describes the robot (see docs/robot.md)."""
    gazes: int = 1
    """Gazes, each from rest. An emulated head has its target placed anew for each; a robot looks at
    what its detector sees."""
    duration_s: Annotated[float, tyro.conf.arg(name="duration")] = 3.0
    """Length of each gaze, in seconds."""
    options: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="FILE")] = None
    """TOML file of options, in a table [controller]; over tuned ones."""
    seed: int = 0
    """Seed of where an emulated head has its targets placed."""
    dry_run: bool = False
    """Ask servos, cameras and the policy, print what it would do, and move nothing."""
    images: bool = False
    """Keep the eyes' images in the log, as JPEGs."""


@dataclass(frozen=True, kw_only=True)
class ReplayConfig:
    """A log that is looked at again."""

    log: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")]
    """Log of `vergence deploy`, whole or cut off."""
    controller: Annotated[
        str | None, tyro.conf.arg(help_behavior_hint="", metavar="CONTROLLER_OR_BUNDLE")
    ] = None
    """Controller to ask again on the log's readings, as `vergence deploy` takes it. By its name the
    log's own runs with the log's options; all others run with their own."""
    options: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="FILE")] = None
    """TOML file of options for it, in a table [controller]."""
    gaze: Annotated[int | None, tyro.conf.arg(help_behavior_hint="", metavar="INT")] = None
    """Gaze to draw, counted from 1; the last one by default."""
