"""The way to where a trial begins: slow, and at first a little to and fro, to see what follows."""

from collections.abc import Callable
from contextlib import suppress
from typing import Final

import numpy as np

from vergence.envs.reading import BoolArray
from vergence.errors import HardwareError
from vergence.hardware.config import HardwareConfig, ServoConfig
from vergence.hardware.safety.motion import inside
from vergence.hardware.safety.supervisor import Supervisor
from vergence.hardware.servo_angles import ServoAngles
from vergence.models.parts import FloatArray

_GAIN: Final = 6.0
"""Rate at which the joints go to where the trial begins, 1/s."""
_MOST_RAD_S: Final = 1.5
_WITHIN_RAD: Final = 0.01
_REST_RAD_S: Final = 0.03
"""Speed below which a joint counts as at rest: a step of the servos' is 0.024 rad/s."""
_RESTED: Final = 6
"""Periods at rest after which the way is over."""
_TIMEOUT_S: Final = 10.0
_BLOCKED_S: Final = 2.0
"""Time at rest away from the goal after which something is in the way, s."""
_PROOF_RAD: Final = 0.1
"""Way by which a joint is moved to see whether it follows, rad: twice what proves it."""
_PROOF_TIMEOUT_S: Final = 3.0


class NotThereError(HardwareError):
    """Joints that have not come to where they were driven."""


def come_to_start(
    goal: FloatArray,
    config: HardwareConfig,
    angles: ServoAngles,
    supervisor: Supervisor,
    move: Callable[[FloatArray], float],
) -> float:
    """See that all joints follow, and bring them to where a trial begins.

    Args:
        goal: (7,) angles of neck and actuators, rad.
        config: what the hardware is.
        angles: see `drive_to`.
        supervisor: knows which joints have followed, and what is in their way.
        move: see `drive_to`.

    Returns:
        When they came to rest, on the clock of `move`, s.

    Raises:
        HardwareError: a trial must not begin there, or the joints do not get there; see `move`.
    """
    goal = np.clip(goal, angles.lower, angles.upper)
    hurt = inside(config.safety.forbidden, goal)
    if hurt is not None:
        raise HardwareError(
            f"safety: start: {hurt.refusal(goal, config.slots)}; cure: another start"
        )
    unproved = angles.there & ~supervisor.proved
    slowest = float(supervisor.most[angles.there].min())
    if unproved.any():
        prove(unproved, config.servos, angles, move)
    try:
        way_s = float(np.abs(goal - angles.angles)[angles.there].max()) / slowest
        return drive_to(goal, config.servos, angles, move, _TIMEOUT_S + way_s)
    except NotThereError as error:
        name = supervisor.in_the_way
        why = f": the forbidden posture {name!r} is in the way" if name else ""
        raise HardwareError(f"{error}{why}") from None


def drive_to(
    goal: FloatArray,
    servos: tuple[ServoConfig, ...],
    angles: ServoAngles,
    move: Callable[[FloatArray], float],
    timeout_s: float = _TIMEOUT_S,
) -> float:
    """Bring neck and actuators to a posture, slowly.

    Args:
        goal: (7,) rad; limited to the servos' ranges.
        servos: what they move.
        angles: where they are; `move` keeps it up to date.
        move: sends (7,) velocities, rad/s, for one control period, and tells the time then, s.
        timeout_s: time after which it is given up, s.

    Returns:
        When they came to rest, on the clock of `move`, s.

    Raises:
        NotThereError: they did not within the time.
        HardwareError: see `move`.
    """
    goal = np.clip(goal, angles.lower, angles.upper)
    now_s = begun_s = move(np.zeros(7))
    moved_s, rested = begun_s, 0
    while rested < _RESTED:
        error = np.where(angles.there, goal - angles.angles, 0.0)
        there = np.abs(error).max() < _WITHIN_RAD
        resting = np.abs(angles.speeds).max() < _REST_RAD_S
        rested = rested + 1 if there and resting else 0
        moved_s = moved_s if resting else now_s
        wish = np.clip(_GAIN * error, -_MOST_RAD_S, _MOST_RAD_S)
        now_s = move(np.zeros(7) if there else wish)
        waited_s, rested_s = now_s - begun_s, now_s - moved_s
        if waited_s > timeout_s or rested_s > _BLOCKED_S:
            worst = max(servos, key=lambda one: abs(error[one.slot]))
            raise NotThereError(
                f"servos: {worst.name}: expected the joint to reach {goal[worst.slot]:.3f} rad "
                f"within {timeout_s:.0f} s, got {angles.angles[worst.slot]:.3f} rad after "
                f"{waited_s:.0f} s"
                + (f", at rest there for {rested_s:.0f} s" if rested_s > _BLOCKED_S else "")
            )
    return now_s


def prove(
    unproved: BoolArray,
    servos: tuple[ServoConfig, ...],
    angles: ServoAngles,
    move: Callable[[FloatArray], float],
) -> None:
    """Move joints a little way towards their middles and back, to see whether they follow.

    Args:
        unproved: (7,) which joints.
        servos: see `drive_to`.
        angles: see `drive_to`.
        move: see `drive_to`.

    Raises:
        HardwareError: see `move`.
    """
    move(np.zeros(7))
    middle = 0.5 * (angles.lower + angles.upper)
    way = np.where(angles.angles <= middle, _PROOF_RAD, -_PROOF_RAD) * unproved
    begin = angles.angles.copy()
    for goal in (begin + way, begin):
        with suppress(NotThereError):  # such as one that a forbidden posture is in the way of
            drive_to(goal, servos, angles, move, _PROOF_TIMEOUT_S)
