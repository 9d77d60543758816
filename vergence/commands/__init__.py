"""Commands of the command line, one module each: dataclasses of options with a `run` method."""

from typing import Annotated

import tyro

from vergence.commands.calibrating import Calibrate
from vergence.commands.check_cameras import CheckCameras
from vergence.commands.collect import Collect
from vergence.commands.deploy import Deploy
from vergence.commands.detect import Detect
from vergence.commands.emulate import Emulate
from vergence.commands.evaluate import Evaluate
from vergence.commands.export import Export
from vergence.commands.gaze import Gaze
from vergence.commands.importing import Import
from vergence.commands.info import Info
from vergence.commands.jog import Jog
from vergence.commands.locate import Locate
from vergence.commands.measure_delay import MeasureDelay
from vergence.commands.print_target import PrintTarget
from vergence.commands.replay import ReplayLog
from vergence.commands.reproduce import Reproduce
from vergence.commands.scan_bus import ScanBus
from vergence.commands.train import Train
from vergence.commands.tune import Tune
from vergence.commands.view import View

__all__ = ["Command"]

Command = (
    Annotated[Gaze, tyro.conf.subcommand("gaze")]
    | Annotated[View, tyro.conf.subcommand("view")]
    | Annotated[Reproduce, tyro.conf.subcommand("reproduce")]
    | Annotated[Train, tyro.conf.subcommand("train")]
    | Annotated[Evaluate, tyro.conf.subcommand("evaluate")]
    | Annotated[Tune, tyro.conf.subcommand("tune")]
    | Annotated[Export, tyro.conf.subcommand("export")]
    | Annotated[Import, tyro.conf.subcommand("import")]
    | Annotated[Locate, tyro.conf.subcommand("locate")]
    | Annotated[Detect, tyro.conf.subcommand("detect")]
    | Annotated[PrintTarget, tyro.conf.subcommand("print-target")]
    | Annotated[Calibrate, tyro.conf.subcommand("calibrate")]
    | Annotated[Collect, tyro.conf.subcommand("collect")]
    | Annotated[Deploy, tyro.conf.subcommand("deploy")]
    | Annotated[ReplayLog, tyro.conf.subcommand("replay")]
    | Annotated[Emulate, tyro.conf.subcommand("emulate")]
    | Annotated[ScanBus, tyro.conf.subcommand("scan-bus")]
    | Annotated[CheckCameras, tyro.conf.subcommand("check-cameras")]
    | Annotated[Jog, tyro.conf.subcommand("jog")]
    | Annotated[MeasureDelay, tyro.conf.subcommand("measure-delay")]
    | Annotated[Info, tyro.conf.subcommand("info")]
)
