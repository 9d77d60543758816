"""Configuration of one gaze; also the options of `vergence gaze`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True, kw_only=True)
class GazeConfig:
    """A target, a head and a controller for one gaze."""

    head: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="HEAD")] = None
    """Head: a preset's name (see `vergence info`) or the path of a TOML file; simulated by default,
    on a robot the head of its configuration."""
    target_mm: Annotated[
        tuple[float, float, float], tyro.conf.arg(name="point", metavar="X Y Z")
    ] = (0.0, -100.0, 1000.0)
    """Position of the target in the base frame N, mm: x right, y down, z forward. The emulator
    places it there; a robot looks at the target that it detects instead."""
    target: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="TARGET")] = None
    """What to look at: tag:36h11:5:120 or checkerboard:9x6:24 (lengths in mm), colour:#RRGGBB,
    face:MODEL.onnx, point, place (that of --point, without images), or mine.py:Class, a detector
    of one's own (see docs/objects.md); a tag by default, on a robot its configuration's target."""
    pixel: Annotated[
        tuple[Literal["left", "right"], float, float] | None,
        tyro.conf.arg(help_behavior_hint="", metavar="EYE U V"),
    ] = None
    """With --target point: the eye and the pixel in its first image."""
    scene: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="SCENE")] = None
    """What stands at the target's place in a simulated room: ball:#RRGGBB:MM, poster:MM,
    poster:FILE:MM (a photograph, such as a printed face) or room (nothing)."""
    wall: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="FILE")] = None
    """Photograph on the room's front wall."""
    controller: Annotated[str, tyro.conf.arg(help_behavior_hint="", metavar="CONTROLLER")] = ""
    """Controller that turns the eyes (see `vergence info`); ibvs by default, on a robot
    state-feedback."""
    gain: Annotated[float | None, tyro.conf.arg(help_behavior_hint="", metavar="FLOAT")] = None
    """Gain of the controller, 1/s; by default the controller's own, and for ibvs 4, less in a
    loop that is slower than the article's."""
    plant: Annotated[str, tyro.conf.arg(metavar="PLANT")] = "rendered"
    """Plant that moves the head and takes the images: rendered (drawn images and a detector),
    mujoco, kinematic, hardware (a robot, or vergence emulate), or module:class of a custom
    plant."""
    hardware: Annotated[
        str | None, tyro.conf.arg(name="config", help_behavior_hint="", metavar="PATH")
    ] = None
    """TOML file that describes the robot of --plant hardware (see docs/robot.md)."""
    view_check: bool = True
    """On a robot, compare the images with the configuration first, while each joint turns by 0.1
    rad with the target in view; without it, a head is moved that may be wired wrongly."""
    seed: int = 0
    """Seed of all noise."""
    duration_s: Annotated[float, tyro.conf.arg(name="duration")] = 2.0
    """Length of the trial, in seconds."""
