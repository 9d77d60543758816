"""Servos in velocity mode brought to rest, and left there."""

from collections.abc import Iterable
from typing import Final

from vergence.errors import HardwareError
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.bus import Bus

_TRIES: Final = 3
"""Times that zero velocity is sent: nothing confirms that it has come."""


def stand_still(bus: Bus, ids: Iterable[int]) -> None:
    """Send zero velocity at once: nothing may turn on while its watchdog is off.

    Raises:
        HardwareError: the line is gone.
    """
    goals = dict.fromkeys(ids, 0)
    for _ in range(_TRIES):
        bus.sync_write(table.GOAL_VELOCITY, goals)


def let_rest(bus: Bus, id: int) -> None:
    """Let a servo rest without its watchdog; with it, where it does not confirm to be at rest.

    Raises:
        HardwareError: it does not.
    """
    try:
        bus.write(id, table.GOAL_VELOCITY, 0)
    except HardwareError:
        # one that its watchdog has stopped takes no goal before its watchdog is off
        if bus.read(id, table.BUS_WATCHDOG) != table.WATCHDOG_TRIPPED:
            bus.write(id, table.GOAL_VELOCITY, 0)
    bus.write(id, table.BUS_WATCHDOG, 0)
    bus.write(id, table.GOAL_VELOCITY, 0)
