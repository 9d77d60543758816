"""List of a robot's checks, printed by each command that moves the robot before it does so."""

import sys
from typing import TYPE_CHECKING

from vergence.commands.console import print_to_stderr

if TYPE_CHECKING:
    from vergence.hardware.config import HardwareConfig


def check_and_print(hardware: "HardwareConfig") -> None:
    """List all checks of a robot on standard error.

    Raises:
        ChecksFailedError: a check failed, so the robot must not move yet.
    """
    from vergence.hardware.checks.listing import check_robot
    from vergence.hardware.checks.servos import raise_errors

    parts = check_robot(hardware)
    width = max(len(one.part) for one in parts)
    for one in parts:
        mark = "ok" if one.what else "-"
        if one.findings:
            mark = "!" if one.ready else "x"
        print(f"{mark:>3} {one.part:<{width}}  {one.what or 'not known'}", file=sys.stderr)
    for finding in raise_errors([finding for one in parts for finding in one.findings]):
        print_to_stderr(f"warning: {finding}")
