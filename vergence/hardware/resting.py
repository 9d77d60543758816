"""Bringing servos in velocity mode to rest, reading that they rest, and leaving them there.

A goal of zero is no rest: a servo whose encoder is blind, or whose motor is inverted, turns on
until it has no torque.
"""

from collections import deque
from collections.abc import Callable, Iterable
from typing import Final

import numpy as np

from vergence.envs.reading import BoolArray
from vergence.errors import ServoRefusalError
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.bus import Bus
from vergence.hardware.dynamixel.repeated import read_register, write_register
from vergence.hardware.safety.following import runaway
from vergence.models.parts import FloatArray

_REPEATS: Final = 3
"""Number of times that zero velocity is sent, as servos do not confirm a broadcast (chosen)."""
_SETTLE_S: Final = 0.3
"""Time at a goal of zero in which a joint has to come to rest, s (chosen: half a second with the
braking before it)."""
_REST_WINDOW_S: Final = 0.06
"""Time over which a joint at rest keeps its angle, s (chosen)."""
_REST_RAD: Final = 0.004
"""Range of the angle of a joint at rest, rad: two steps of an encoder of 4,096 (chosen)."""
_READ_INTERVAL_S: Final = 0.008
"""Time between two readings, s (chosen)."""
_MOST_READS: Final = 100
"""Most readings, in a process whose clock or line is slow (numerical)."""


def settle(
    read_angles: Callable[[], FloatArray],
    release: Callable[[BoolArray], None],
    clock: Callable[[], float],
    sleep: Callable[[float], None],
) -> BoolArray:
    """Read that joints come to rest at a goal of zero; those that do not lose their torque.

    A joint whose speed grows loses it at once, others after `_SETTLE_S`.

    Args:
        read_angles: reads (n,) angles, rad; nan for joints without torque or answer.
        release: switches off the torque of joints, (n,) True.
        clock: a monotonic clock, s.
        sleep: waits for some seconds.

    Returns:
        (n,) True for joints that have lost their torque here.

    Raises:
        HardwareError: the line is gone.
    """
    begun_s = clock()
    rows: deque[tuple[float, FloatArray]] = deque(maxlen=64)
    released = np.zeros(len(angles := read_angles()), dtype=np.bool_)
    for _ in range(_MOST_READS):
        now_s = clock()
        rows.append((now_s, angles))
        times, turned = np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
        recent = turned[times >= now_s - _REST_WINDOW_S]
        moves = ~released & (np.ptp(recent, axis=0) > _REST_RAD)  # not those that are nan
        bad = ~released & (runaway(now_s, times, turned, np.zeros_like(turned)) > 0.0)
        if now_s - begun_s > _SETTLE_S:
            bad |= moves
        if bad.any():
            released |= bad
            release(bad)
        elif not moves.any() and now_s - begun_s >= _REST_WINDOW_S:
            break
        sleep(_READ_INTERVAL_S)
        angles = read_angles()
    return released


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
