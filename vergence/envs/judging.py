"""Arrays of a batch of gaze tasks: their actions, and the results of their steps."""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.envs.layout import ObservationLayout
from vergence.envs.reading import Reading
from vergence.envs.reward import StepResult, TimeLimits, TrialProgress, compute_step_result
from vergence.envs.streams import IntArray
from vergence.kernels import compiled, inlined, unpack_table
from vergence.models.head import HeadModel
from vergence.models.kinematics import PackedHead
from vergence.models.parts import FloatArray

LIMIT: Final = 1
"""Phase of a step, one bit: limit the requested actions, and convert them to commands
(numerical)."""
JUDGE: Final = 2
"""Phase, one bit: compute observations, rewards and ends from the reading (numerical)."""


class TaskArrays(NamedTuple):
    """Actions, commands and results of a batch of gaze tasks, and the rules that they follow."""

    requested: FloatArray
    """(n, m) actions as requested, for the m actuators."""
    action: FloatArray
    """(n, m) actions as applied, limited to [-1, 1]."""
    command: FloatArray
    """(n, 7) velocities commanded by them, rad/s; see `vergence.envs.plant.Plant.step`."""
    action_limits: FloatArray
    """(4,) velocities of full actions, rad/s; 0 beyond the first m."""
    head: PackedHead
    """(PACKED,) the head that the controller knows."""
    scaling: FloatArray
    """(SCALING,) see `vergence.envs.encoding`."""
    time_limits: TimeLimits
    progress: TrialProgress
    result: StepResult
    coupled_head: PackedHead | None
    """The packed head again if its eye joints are coupled, else None; code for coupled joints is
    then not compiled."""

    @classmethod
    def empty(cls, head: HeadModel, num: int) -> "TaskArrays":
        """Arrays for `num` heads, before their trials begin."""
        layout = ObservationLayout.of(head)
        return cls(
            requested=np.zeros((num, layout.count)),
            action=np.zeros((num, layout.count)),
            command=np.zeros((num, 7)),
            action_limits=layout.action_limits,
            head=head.packed,
            scaling=layout.scaling,
            time_limits=TimeLimits.of(head),
            progress=TrialProgress.empty(num),
            result=StepResult.empty(num, layout.size),
            coupled_head=None if head.actuation.direct else head.packed,
        )


@compiled
def limit_actions(ids: IntArray, task: TaskArrays) -> bool:
    """Limit requested actions and convert them to commands; the neck's are unchanged.

    Args:
        ids: (m,) environment indices.
        task: `untyped_tuple`.

    Returns:
        False if a requested action of any environment is nan; nothing is changed then.
    """
    requested, action, command, limits = task[0], task[1], task[2], task[3]
    for n in range(requested.shape[0]):
        for j in range(requested.shape[1]):
            if requested[n, j] != requested[n, j]:
                return False
    for n in ids:
        for j in range(requested.shape[1]):
            action[n, j] = a = min(max(requested[n, j], -1.0), 1.0)
            command[n, 3 + j] = a * limits[j]
    return True


@inlined
def judge_steps(ids: IntArray, task: TaskArrays, reading: Reading) -> None:
    """Compute the results of the last steps of some environments, see `compute_step_result`."""
    own = TaskArrays(*task)
    compute_step_result(
        ids, own.head, own.scaling, own.time_limits, reading, own.action, own.progress, own.result,
        own.coupled_head,
    )  # fmt: skip


@compiled
def advance_task(table: NDArray[np.void], ids: IntArray, phases: int) -> bool:
    """Run phases of a step that precede and follow those of a plant which is stepped by itself.

    Args:
        table: table of `TaskArrays` and the plant's `Reading`.
        ids: (m,) environment indices.
        phases: `LIMIT` and `JUDGE`.

    Returns:
        False if an action is nan.
    """
    task, reading = unpack_table(table)
    if phases & LIMIT and not limit_actions(ids, task):
        return False
    if phases & JUDGE:
        judge_steps(ids, task, reading)
    return True
