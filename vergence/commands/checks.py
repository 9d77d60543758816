"""List of a robot's checks, printed by each command that moves the robot before it does so."""

import sys
from typing import TYPE_CHECKING

from vergence.commands.console import print_to_stderr

if TYPE_CHECKING:
    from vergence.hardware.config import HardwareConfig


def check_robot_and_print(hardware: "HardwareConfig") -> None:
    """Run all checks of a robot and print their results; raise an error if one has failed."""
    from vergence.hardware.checks import check_robot, raise_errors

    parts = check_robot(hardware)
    width = max(len(one.name) for one in parts)
    for one in parts:
        mark = "ok" if one.description else "-"
        if one.findings:
            mark = "!" if one.ready else "x"
        print(f"{mark:>3} {one.name:<{width}}  {one.description or 'not known'}", file=sys.stderr)
    for finding in raise_errors([finding for one in parts for finding in one.findings]):
        print_to_stderr(f"warning: {finding}")
