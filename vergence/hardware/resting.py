"""Bringing servos in velocity mode to rest, and leaving them there."""

from collections.abc import Iterable
from typing import Final

from vergence.errors import HardwareError
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.bus import Bus

_REPEATS: Final = 3
"""Number of times that zero velocity is sent, as servos do not confirm a broadcast (chosen)."""


def broadcast_zero_speed(bus: Bus, ids: Iterable[int]) -> None:
    """Send zero velocity at once, so that no servo keeps turning while its watchdog is off.

    Raises:
        HardwareError: the line is gone.
    """
    goals = dict.fromkeys(ids, 0)
    for _ in range(_REPEATS):
        bus.sync_write(table.GOAL_VELOCITY, goals)


def stop_and_disable_watchdog(bus: Bus, id: int) -> None:
    """Bring a servo to rest and switch its watchdog off.

    The watchdog stays on if the servo does not confirm zero velocity. The torque is not changed.

    Raises:
        HardwareError: the servo does not confirm that it is at rest.
    """
    try:
        bus.write(id, table.GOAL_VELOCITY, 0)
    except HardwareError:
        # a servo whose watchdog has tripped accepts no goal until its watchdog is off
        if bus.read(id, table.BUS_WATCHDOG) != table.WATCHDOG_TRIPPED:
            bus.write(id, table.GOAL_VELOCITY, 0)
    bus.write(id, table.BUS_WATCHDOG, 0)
    bus.write(id, table.GOAL_VELOCITY, 0)
