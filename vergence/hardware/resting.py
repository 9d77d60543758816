"""Bringing servos in velocity mode to rest, and leaving them there."""

from collections.abc import Iterable
from typing import Final

from vergence.errors import ServoRefusalError
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.bus import Bus
from vergence.hardware.dynamixel.repeated import read_register, write_register

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

    The watchdog stays on if the servo does not confirm zero velocity. The torque is not changed,
    but for `disable_watchdog`.

    Raises:
        HardwareError: the servo does not confirm that it is at rest.
    """
    try:
        write_register(bus, id, table.GOAL_VELOCITY, 0)
    except ServoRefusalError:
        # a servo whose watchdog has tripped accepts no goal until its watchdog is off
        if read_register(bus, id, table.BUS_WATCHDOG) not in (0, table.WATCHDOG_TRIPPED):
            raise
    disable_watchdog(bus, id)


def disable_watchdog(bus: Bus, id: int) -> None:
    """Switch a servo's watchdog off, and set its goal to zero velocity.

    Some firmware locks the goals of a servo whose watchdog has tripped until its torque has been
    off: then it is switched off and on, once. If it is off, the lock stays until it is switched on.

    Raises:
        HardwareError: the servo does not confirm it.
    """
    write_register(bus, id, table.BUS_WATCHDOG, 0)
    try:
        write_register(bus, id, table.GOAL_VELOCITY, 0)
    except ServoRefusalError:
        if read_register(bus, id, table.TORQUE_ENABLE):
            write_register(bus, id, table.TORQUE_ENABLE, 0)
            write_register(bus, id, table.TORQUE_ENABLE, 1)
            write_register(bus, id, table.GOAL_VELOCITY, 0)
