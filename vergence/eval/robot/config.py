"""Configurations of a deployment on a robot and of a replay; also the options of their commands."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True, kw_only=True)
class DeployConfig:
    """A deployment of a policy on a robot."""

    controller: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="CONTROLLER_OR_BUNDLE")]
    """Controller: a name (see `vergence info`), a .vgp bundle, an .onnx file, module:class or
    path/to/file.py:class."""
    hardware: Annotated[Path, tyro.conf.arg(name="config", metavar="PATH")]
    """TOML file that describes the robot (see docs/robot.md)."""
    gazes: int = 1
    """Number of gazes, each from rest. An emulated head gets a new target position for each; a
    robot looks at the target that its detector finds."""
    duration_s: Annotated[float, tyro.conf.arg(name="duration")] = 3.0
    """Duration of each gaze, in seconds."""
    target: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="TARGET")] = None
    """What to look at, see `vergence gaze --help`; the configuration's target by default."""
    pixel: Annotated[
        tuple[Literal["left", "right"], float, float] | None,
        tyro.conf.arg(help_behavior_hint="", metavar="EYE U V"),
    ] = None
    """With --target point: the eye and the pixel in its first image; none to click it in
    vergence view --follow."""
    target_mm: Annotated[
        tuple[float, float, float] | None,
        tyro.conf.arg(name="point", help_behavior_hint="", metavar="X Y Z"),
    ] = None
    """A place to look at without a target in the images, mm in N: x right, y down, z forward."""
    options: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="FILE")] = None
    """TOML file of options, in a table [controller]; they override tuned ones."""
    seed: int = 0
    """Seed of the target positions before an emulated head."""
    dry_run: bool = False
    """Query servos, cameras and the policy, print the commands, and move nothing."""
    view_check: bool = True
    """Compare the images with the configuration before the first gaze, while each joint turns by
    0.1 rad with the target in view; without it, a head is moved that may be wired wrongly."""
    images: bool = False
    """Keep the eyes' images in the log, as JPEGs."""
    resume: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="LOG")] = None
    """Log of a deployment that has ended early: run the gazes that are missing there."""


@dataclass(frozen=True, kw_only=True)
class ReplayConfig:
    """A replay of a log."""

    log: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")]
    """Log of `vergence deploy`, whole or cut off."""
    controller: Annotated[
        str | None, tyro.conf.arg(help_behavior_hint="", metavar="CONTROLLER_OR_BUNDLE")
    ] = None
    """Controller to run again on the log's readings, given as for `vergence deploy`. The log's own,
    if given by its name, runs with the log's options; all others run with their own."""
    options: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="FILE")] = None
    """TOML file of options for it, in a table [controller]."""
    gaze: Annotated[int | None, tyro.conf.arg(help_behavior_hint="", metavar="INT")] = None
    """Gaze to draw, counted from 1; the last one by default."""
