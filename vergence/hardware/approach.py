"""Driving joints slowly to a posture, and the small motion that proves that they follow."""

from collections.abc import Callable
from contextlib import suppress
from typing import Final

import numpy as np

from vergence.envs.reading import BoolArray
from vergence.errors import HardwareError
from vergence.hardware.config import HardwareConfig
from vergence.hardware.safety.limits import find_containing_posture
from vergence.hardware.safety.supervisor import Supervisor
from vergence.hardware.servos import JointAngles
from vergence.models.parts import FloatArray

_GAIN: Final = 6.0
"""Gain of the approach, speed per remaining angle, 1/s (chosen)."""
_MAX_SPEED_RAD_S: Final = 1.5
"""Greatest requested speed of the approach, rad/s (chosen)."""
_TOLERANCE_RAD: Final = 0.01
"""Tolerance of the posture, rad (chosen)."""
REST_RAD_S: Final = 0.03
"""Joints slower than this are at rest, rad/s: above a servo's unit of 0.024 rad/s (chosen)."""
REST_PERIODS: Final = 6
"""Consecutive control periods at rest at the goal that end the approach: three time constants of
the servos (chosen)."""
_TIMEOUT_S: Final = 10.0
"""Longest time to a start, s; that at the slowest joint's speed is added (chosen)."""
_BLOCKED_S: Final = 2.0
"""Time at rest away from the goal after which the joint is blocked, s (chosen)."""
PROOF_RAD: Final = 0.1
"""Motion that tests whether a joint follows, rad: twice what proves it (chosen)."""
PROOF_TIMEOUT_S: Final = 3.0
"""Longest time of each half of that motion, s (chosen)."""

Move = Callable[[FloatArray], float]
"""Sends (7,) velocities, rad/s, for a control period; updates the angles; returns the time, s."""


class GoalNotReachedError(HardwareError):
    """Joints that have not reached their goal."""


def drive_to_start(
    goal: FloatArray,
    config: HardwareConfig,
    angles: JointAngles,
    supervisor: Supervisor,
    move: Move,
) -> float:
    """Check that joints follow, drive to a start, (7,) rad; return the time of rest there, s."""
    goal = np.clip(goal, angles.lower, angles.upper)
    entered = find_containing_posture(config.safety.forbidden, goal)
    if entered is not None:
        raise HardwareError(
            f"safety: start: {entered.refusal(goal, config.slots)}; cure: another start"
        )
    unproved = angles.has_servo & ~supervisor.proved_joints
    slowest = float(supervisor.max_speed[angles.has_servo].min())
    if unproved.any():
        nudge_unproved_joints(unproved, config, angles, move)
    try:
        way_s = float(np.abs(goal - angles.angles)[angles.has_servo].max()) / slowest
        return drive_to(goal, config, angles, move, timeout_s=_TIMEOUT_S + way_s)
    except GoalNotReachedError as error:
        name = supervisor.limiting_posture
        why = f": the forbidden posture {name!r} is in the way" if name else ""
        raise HardwareError(f"{error}{why}") from None


def drive_to(
    goal: FloatArray,
    config: HardwareConfig,
    angles: JointAngles,
    move: Move,
    *,
    timeout_s: float,
    speed_rad_s: float = _MAX_SPEED_RAD_S,
    tolerance_rad: float = _TOLERANCE_RAD,
) -> float:
    """Drive neck and actuators slowly to a posture, and to rest.

    Args:
        goal: (7,) goal angles, rad; clipped to the servos' ranges.
        config: the hardware configuration.
        angles: present angles of the servos; `move` updates them.
        move: see `Move`.
        timeout_s: time limit, s.
        speed_rad_s: greatest requested speed, rad/s.
        tolerance_rad: tolerance of the posture, rad.

    Returns:
        Time at which they came to rest, on the clock of `move`, s.

    Raises:
        GoalNotReachedError: they did not get there in time, or stopped on the way.
        HardwareError: see `move`.
    """
    goal = np.clip(goal, angles.lower, angles.upper)
    now_s = moved_s = begun_s = move(np.zeros(7))
    rested = 0
    while rested < REST_PERIODS:
        error = np.where(angles.has_servo, goal - angles.angles, 0.0)
        arrived = np.abs(error).max() < tolerance_rad
        resting = np.abs(angles.speeds).max() < REST_RAD_S
        rested = rested + 1 if arrived and resting else 0
        moved_s = moved_s if resting else now_s
        requested = np.clip(_GAIN * error, -speed_rad_s, speed_rad_s)
        now_s = move(np.zeros(7) if arrived else requested)
        waited_s, rested_s = now_s - begun_s, now_s - moved_s
        if waited_s > timeout_s or rested_s > _BLOCKED_S:
            worst = max(config.servos, key=lambda one: abs(error[one.slot]))
            raise GoalNotReachedError(
                f"servos: {worst.name}: expected the joint to reach {goal[worst.slot]:.3f} rad "
                f"within {timeout_s:.0f} s, got {angles.angles[worst.slot]:.3f} rad after "
                f"{waited_s:.0f} s"
                + (f", at rest there for {rested_s:.0f} s" if rested_s > _BLOCKED_S else "")
            )
    return now_s


def nudge_unproved_joints(
    unproved: BoolArray, config: HardwareConfig, angles: JointAngles, move: Move
) -> None:
    """Move joints, (7,) True, a little towards the middle of their range and back.

    The supervisor, which sees the motion, then counts them as proved or stops the head; a goal that
    is not reached is no error here.
    """
    move(np.zeros(7))
    middle = 0.5 * (angles.lower + angles.upper)
    way = np.where(angles.angles <= middle, PROOF_RAD, -PROOF_RAD) * unproved
    begin = angles.angles.copy()
    for goal in (begin + way, begin):
        with suppress(GoalNotReachedError):  # for example if a forbidden posture is in the way
            drive_to(goal, config, angles, move, timeout_s=PROOF_TIMEOUT_S)
