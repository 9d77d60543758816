r"""Commands on their way to the motors: quantisation, dead band, latency and losses.

A command holds for one period. For the motors, this period begins one command latency after the
command was given. A control period T is therefore split: until `latency modulo T` the earlier
command applies, then the next one.

If a command is lost or the loop stalls, the command of the period before stays in force.
"""

from math import ceil
from typing import Final, NamedTuple

import numpy as np

from vergence.envs.plants.conditions import TrialConditions
from vergence.envs.plants.frames import TIME_TOLERANCE_S, ring_size
from vergence.envs.streams import IntArray, StreamKey, StreamPurpose, random_words, to_uniform
from vergence.kernels import compiled, inlined
from vergence.models.parts import FloatArray

_ROUNDING: Final = 1e-9
"""Rounding tolerance, as a fraction of a limit or of a period (numerical)."""
_COMMAND: Final = int(StreamPurpose.COMMAND)


class CommandBuffers(NamedTuple):
    """Ring buffers of the last commands; the command of step k lies at k modulo C."""

    velocities: FloatArray
    """(n, C, 7) commands as they reach the motors, limited and quantised, rad/s; zero in the dead
    band of one quantisation step."""
    velocity_limits: FloatArray
    """(7,) velocity limits, rad/s."""
    quantisation_step: float
    """Quantisation step of the commands, rad/s; 0 for exact."""

    @classmethod
    def empty(
        cls,
        num: int,
        velocity_limits: FloatArray,
        quantisation_step: float,
        max_latency_s: float,
        period_s: float,
    ) -> "CommandBuffers":
        """Buffers of zero commands, long enough for all commands that have not taken effect yet.

        Args:
            num: number of heads.
            velocity_limits: (7,) velocity limits, rad/s.
            quantisation_step: quantisation step, rad/s.
            max_latency_s: the largest command latency, s.
            period_s: the control period.
        """
        size = ring_size(ceil(max_latency_s / period_s) + 2)
        return cls(np.zeros((num, size, 7)), velocity_limits, quantisation_step)


RESUME_PERIOD: Final = 0
"""Column of a loop's state row: period in which the loop resumes after its last stall
(numerical)."""
COMMAND_LOST: Final = 1
"""Column: nonzero if the present period's command never reaches the motors (numerical)."""
LAST_READ_STEP: Final = 2
"""Column: step at which the joints were read last (numerical)."""
LOOP_STATE: Final = 3
"""Length of the state row of a control loop (numerical)."""


@inlined
def is_command_lost(conditions: TrialConditions, key: StreamKey, step: int) -> bool:
    """True if a period's command never reaches the motors."""
    chance = conditions.lost_command_probability
    if chance == 0.0:
        return False
    return to_uniform(random_words(key.seed, key.trial, _COMMAND, step, 1)[0]) < chance


@inlined
def loop_resumes_at(
    conditions: TrialConditions, key: StreamKey, step: int, period_s: float, last_resume_period: int
) -> int:
    """Number of the period from which the loop runs again; at most `step` while it runs.

    A loop that stalls at `step` returns a later period, drawn from the trial's random stream. It
    runs for at least one period between two stalls.

    Args:
        conditions: the trial's conditions.
        key: key of the trial's random stream.
        step: number of the period, one more than in the last call.
        period_s: the control period, s.
        last_resume_period: result of the last call.
    """
    chance = conditions.stall_probability
    if chance == 0.0 or step == 0 or step <= last_resume_period:
        return last_resume_period
    words = random_words(key.seed, key.trial, _COMMAND, step, 1)
    if not to_uniform(words[1]) < chance:
        return last_resume_period
    return step + max(int(np.rint(to_uniform(words[2]) * conditions.stall_s / period_s)), 1)


@compiled
def store_commands(
    ids: IntArray,
    command: FloatArray,
    commands: CommandBuffers,
    control_loop_states: IntArray,
    step: IntArray,
    sent: FloatArray,
) -> bool:
    """Limit and quantise the commands of a period, and write them to the ring buffers.

    Args:
        ids: (m,) environment indices.
        command: (n, 7) velocity commands, rad/s.
        commands: `untyped_tuple`, updated in place.
        control_loop_states: (n, LOOP_STATE) states of the control loops: stalls and lost commands.
        step: (n,) number of the period.
        sent: (n, 7) result: commands sent to the motors, rad/s; a stalled loop sends nothing and
            keeps its last value.

    Returns:
        False if any command is nan.
    """
    commands = CommandBuffers(*commands)
    given, limits, size = commands.velocities, commands.velocity_limits, commands.quantisation_step
    numbers, mask = True, given.shape[1] - 1
    for n in ids:
        slot, before = np.uintp(step[n] & mask), np.uintp((step[n] - 1) & mask)
        stalled = step[n] < control_loop_states[n, RESUME_PERIOD]
        lost = control_loop_states[n, COMMAND_LOST] != 0
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


class HeldCommands(NamedTuple):
    """Ring positions of the commands that apply to the motors within a period."""

    position_before: np.uintp
    """Position of the command that applies at the period's beginning."""
    position_after: np.uintp
    """Position of the command that applies from the change on."""
    change_s: float
    """Time of the change since the period's beginning, s."""


@inlined
def held_commands(latency_s: float, step: int, ring_length: int, period_s: float) -> HeldCommands:
    """Find the commands that apply within a period.

    Args:
        latency_s: the command latency, s.
        step: number of the period.
        ring_length: C, length of the ring buffers of `CommandBuffers`.
        period_s: the control period, s.
    """
    mask = ring_length - 1
    if latency_s == 0.0:
        now = np.uintp(step & mask)
        return HeldCommands(now, now, 0.0)
    whole = int(latency_s / period_s + _ROUNDING)
    rest = latency_s - whole * period_s
    then = np.uintp((step - whole) & mask)
    if rest < TIME_TOLERANCE_S:
        return HeldCommands(then, then, 0.0)
    return HeldCommands(np.uintp((step - whole - 1) & mask), then, rest)
