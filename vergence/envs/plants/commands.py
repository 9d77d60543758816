r"""From a command to the motors: its steps, those too small to move, its latency and its losses.

A command holds for a period, which begins for the motors one command latency after the command was
given. So a period is divided: until `latency modulo T` the command before counts, then the next.

Where a command is lost, or the loop stalls, the command of the period before stands in its place.
"""

from math import ceil
from typing import Final, NamedTuple

import numpy as np

from vergence._jit import compiled, device
from vergence.envs.plants.conditions import Loop
from vergence.envs.plants.frames import SAME_S, ring_size
from vergence.envs.streams import IntArray, Key, Purpose, random_words, to_uniform
from vergence.models.parts import FloatArray

_ROUNDING: Final = 1e-9
_COMMAND: Final = int(Purpose.COMMAND)


class Commands(NamedTuple):
    """The commands that were given last; that of step k lies at k modulo C."""

    given: FloatArray
    """(n, C, 7) as they reach the motors: within the limits and in steps, rad/s; zero where a step
    moves nothing."""
    limit: FloatArray
    """(7,) greatest commands, rad/s."""
    step: float
    """Step of the commands, rad/s; 0 for exact."""

    @classmethod
    def empty(
        cls, num: int, limit: FloatArray, step: float, longest_s: float, period_s: float
    ) -> "Commands":
        """Room for those that have not all taken effect, none of which moves anything.

        Args:
            num: how many heads.
            limit: (7,) rad/s.
            step: rad/s.
            longest_s: the greatest command latency, s.
            period_s: the control period.
        """
        size = ring_size(ceil(longest_s / period_s) + 2)
        return cls(np.zeros((num, size, 7)), limit, step)


RESUMES: Final = 0
"""Column of a loop's row: the period in which it goes on, or went on, after its last stall."""
LOST: Final = 1
"""Whether the present period's command never reaches the motors."""
READ: Final = 2
"""The step at which joints were read last."""
LOOP_STATE: Final = 3
"""Numbers of a row that says how a control loop stands."""


@device
def is_lost(loop: Loop, key: Key, step: int) -> bool:
    """Whether a period's command never reaches the motors."""
    chance = loop.lost_command_probability
    if chance == 0.0:
        return False
    return to_uniform(random_words(key.seed, key.trial, _COMMAND, step, 1)[0]) < chance


@device
def stalled_until(loop: Loop, key: Key, step: int, period_s: float, resumes: int) -> int:
    """The period in which the loop goes on: `step` itself or an earlier one where it runs.

    Two stalls have a period between them in which the loop runs.

    Args:
        loop: the trial's conditions.
        key: that of its random numbers.
        step: the period, which follows on the one that was asked for before.
        period_s: how long one is.
        resumes: the answer of the period before.
    """
    chance = loop.stall_probability
    if chance == 0.0 or step == 0 or step <= resumes:
        return resumes
    words = random_words(key.seed, key.trial, _COMMAND, step, 1)
    if not to_uniform(words[1]) < chance:
        return resumes
    return step + max(int(np.rint(to_uniform(words[2]) * loop.stall_s / period_s)), 1)


@compiled
def take_commands(
    command: FloatArray,
    commands: Commands,
    loops: IntArray,
    step: IntArray,
    sent: FloatArray,
) -> bool:
    """Take the commands of a period.

    Args:
        command: (n, 7) velocity commands, rad/s.
        commands: `bare`, brought up to date.
        loops: (n, LOOP_STATE) which loops stall, and which lose the command.
        step: (n,) the period's number.
        sent: (n, 7) result: what was sent to the motors, rad/s; a stalled loop has sent nothing,
            and what it sent last stays.

    Returns:
        False if any command is nan.
    """
    commands = Commands(*commands)
    given, limits, size = commands.given, commands.limit, commands.step
    numbers, mask = True, given.shape[1] - 1
    for n in range(command.shape[0]):
        slot, before = np.uintp(step[n] & mask), np.uintp((step[n] - 1) & mask)
        stalled = step[n] < loops[n, RESUMES]
        lost = loops[n, LOST] != 0
        for j in range(7):
            u, limit = command[n, j], limits[j]
            if u != u:
                numbers = False
            if stalled:
                given[n, slot, j] = given[n, before, j]
                continue
            u = min(max(u, -limit), limit)
            moving = u
            if size > 0.0:
                count = np.rint(u / size)
                if abs(count) * size > limit * (1.0 + _ROUNDING):
                    count -= np.sign(count)
                u = moving = size * count
                if abs(count) <= 1.0:
                    moving = 0.0
            sent[n, j] = u
            given[n, slot, j] = given[n, before, j] if lost else moving
    return numbers


class Hold(NamedTuple):
    """Which commands a period has for the motors."""

    first: np.uintp
    """Where the one lies that counts at its beginning."""
    then: np.uintp
    """Where the one lies that counts from the change on."""
    change_s: float
    """When it changes, since the period's beginning, s."""


@device
def hold_of(late_s: float, step: int, ring: int, period_s: float) -> Hold:
    """What counts in a period.

    Args:
        late_s: the command latency, s.
        step: the period's number.
        ring: C, see `Commands`.
        period_s: the period.
    """
    mask = ring - 1
    if late_s == 0.0:
        now = np.uintp(step & mask)
        return Hold(now, now, 0.0)
    whole = int(late_s / period_s + _ROUNDING)
    rest = late_s - whole * period_s
    then = np.uintp((step - whole) & mask)
    if rest < SAME_S:
        return Hold(then, then, 0.0)
    return Hold(np.uintp((step - whole - 1) & mask), then, rest)
