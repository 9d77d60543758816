"""Drive to the start of a trial: slowly, after a small motion that proves that joints follow."""

from collections.abc import Callable
from contextlib import suppress
from typing import Final

import numpy as np

from vergence.envs.reading import BoolArray
from vergence.errors import HardwareError
from vergence.hardware.config import HardwareConfig, ServoConfig
from vergence.hardware.safety.motion import find_containing_posture
from vergence.hardware.safety.supervisor import Supervisor
from vergence.hardware.servo_angles import ServoAngles
from vergence.models.parts import FloatArray

_GAIN: Final = 6.0
"""Gain of the drive to the start, speed per remaining angle, 1/s (chosen)."""
_MAX_SPEED_RAD_S: Final = 1.5
"""Greatest requested speed of the drive to the start, rad/s (chosen)."""
_TOLERANCE_RAD: Final = 0.01
"""Tolerance of the start posture, rad (chosen)."""
_REST_RAD_S: Final = 0.03
"""Joints slower than this are at rest, rad/s: above a servo's unit of 0.024 rad/s (chosen)."""
_REST_PERIODS: Final = 6
"""Consecutive control periods at rest at the goal that end the drive (chosen)."""
_TIMEOUT_S: Final = 10.0
"""Longest time of the drive, s; that at the slowest joint's speed is added (chosen)."""
_BLOCKED_S: Final = 2.0
"""Time at rest away from the goal after which the joint is blocked, s (chosen)."""
PROOF_RAD: Final = 0.1
"""Motion that tests whether a joint follows, rad: twice what proves it (chosen)."""
PROOF_TIMEOUT_S: Final = 3.0
"""Longest time of each half of that motion, s (chosen)."""


class GoalNotReachedError(HardwareError):
    """Joints that have not reached their goal."""


def drive_to_start(
    goal: FloatArray,
    config: HardwareConfig,
    angles: ServoAngles,
    supervisor: Supervisor,
    send_velocities: Callable[[FloatArray], float],
) -> float:
    """Check that all joints follow, and drive them to the start of a trial.

    Args:
        goal: (7,) angles of neck and actuators, rad.
        config: the hardware configuration.
        angles: see `drive_to`.
        supervisor: source of the proved joints and of the forbidden posture in the way.
        send_velocities: see `drive_to`.

    Returns:
        Time at which they came to rest, on the clock of `send_velocities`, s.

    Raises:
        HardwareError: a trial must not begin there, or the joints do not get there; see
            `send_velocities`.
    """
    goal = np.clip(goal, angles.lower, angles.upper)
    entered = find_containing_posture(config.safety.forbidden, goal)
    if entered is not None:
        raise HardwareError(
            f"safety: start: {entered.refusal(goal, config.slots)}; cure: another start"
        )
    unproved = angles.has_servo & ~supervisor.proved_joints
    slowest = float(supervisor.max_speed[angles.has_servo].min())
    if unproved.any():
        nudge_unproved_joints(unproved, config.servos, angles, send_velocities)
    try:
        way_s = float(np.abs(goal - angles.angles)[angles.has_servo].max()) / slowest
        return drive_to(goal, config.servos, angles, send_velocities, _TIMEOUT_S + way_s)
    except GoalNotReachedError as error:
        name = supervisor.limiting_posture
        why = f": the forbidden posture {name!r} is in the way" if name else ""
        raise HardwareError(f"{error}{why}") from None


def drive_to(
    goal: FloatArray,
    servos: tuple[ServoConfig, ...],
    angles: ServoAngles,
    send_velocities: Callable[[FloatArray], float],
    timeout_s: float = _TIMEOUT_S,
) -> float:
    """Drive neck and actuators slowly to a posture.

    Args:
        goal: (7,) goal angles, rad; clipped to the servos' ranges.
        servos: configuration of the servos.
        angles: present angles of the servos; `send_velocities` updates them.
        send_velocities: sends (7,) velocities, rad/s, for one control period; returns the time, s.
        timeout_s: time limit, s.

    Returns:
        Time at which they came to rest, on the clock of `send_velocities`, s.

    Raises:
        GoalNotReachedError: they did not get there in time, or stopped on the way.
        HardwareError: see `send_velocities`.
    """
    goal = np.clip(goal, angles.lower, angles.upper)
    now_s = begun_s = send_velocities(np.zeros(7))
    moved_s, rested = begun_s, 0
    while rested < _REST_PERIODS:
        error = np.where(angles.has_servo, goal - angles.angles, 0.0)
        arrived = np.abs(error).max() < _TOLERANCE_RAD
        resting = np.abs(angles.speeds).max() < _REST_RAD_S
        rested = rested + 1 if arrived and resting else 0
        moved_s = moved_s if resting else now_s
        requested = np.clip(_GAIN * error, -_MAX_SPEED_RAD_S, _MAX_SPEED_RAD_S)
        now_s = send_velocities(np.zeros(7) if arrived else requested)
        waited_s, rested_s = now_s - begun_s, now_s - moved_s
        if waited_s > timeout_s or rested_s > _BLOCKED_S:
            worst = max(servos, key=lambda one: abs(error[one.slot]))
            raise GoalNotReachedError(
                f"servos: {worst.name}: expected the joint to reach {goal[worst.slot]:.3f} rad "
                f"within {timeout_s:.0f} s, got {angles.angles[worst.slot]:.3f} rad after "
                f"{waited_s:.0f} s"
                + (f", at rest there for {rested_s:.0f} s" if rested_s > _BLOCKED_S else "")
            )
    return now_s


def nudge_unproved_joints(
    unproved: BoolArray,
    servos: tuple[ServoConfig, ...],
    angles: ServoAngles,
    send_velocities: Callable[[FloatArray], float],
) -> None:
    """Move joints a little towards the middle of their range and back.

    The supervisor, which sees the motion, then counts them as proved or stops the head; a goal that
    is not reached is no error here.

    Args:
        unproved: (7,) True for the joints to move.
        servos: see `drive_to`.
        angles: see `drive_to`.
        send_velocities: see `drive_to`.

    Raises:
        HardwareError: see `send_velocities`.
    """
    send_velocities(np.zeros(7))
    middle = 0.5 * (angles.lower + angles.upper)
    way = np.where(angles.angles <= middle, PROOF_RAD, -PROOF_RAD) * unproved
    begin = angles.angles.copy()
    for goal in (begin + way, begin):
        with suppress(GoalNotReachedError):  # for example if a forbidden posture is in the way
            drive_to(goal, servos, angles, send_velocities, PROOF_TIMEOUT_S)
