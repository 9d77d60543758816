"""A control period of simulated heads in phases, of which one compiled call runs any number.

A step of a single head is mostly calls of compiled code, and their cost is that of their arguments.
So a plant makes a table of all arrays of a step, once, and calls a single function with it.
"""

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.envs.judging import JUDGE, LIMIT, TaskArrays, judge_steps, limit_actions
from vergence.envs.plants.commands import CommandBuffers, store_commands
from vergence.envs.plants.conditions import PackedConditions
from vergence.envs.plants.feedback import JointFeedbackBuffers
from vergence.envs.plants.frames import Exposures, Frames
from vergence.envs.plants.motors import ActuatorCoupling, MotorStates, name_coupling
from vergence.envs.plants.scene import TrueHeadsAndTargets
from vergence.envs.plants.sensing import SensorTiming, read_sensors, simulate_detections
from vergence.envs.plants.starting import expose_frames_before_start
from vergence.envs.reading import Reading
from vergence.envs.streams import IntArray, StreamKeys
from vergence.kernels import subroutine, unpack_table

# further phases, one bit each, in their order between LIMIT and JUDGE (numerical)
STORE: Final = 4
"""Write the commands to the ring buffers (numerical)."""
MOVE: Final = 8
"""Move the joints through the period, and record them at its exposures (numerical)."""
EXPOSE: Final = 16
"""Take the period's frames (numerical)."""
REPORT: Final = 32
"""Read the sensors (numerical)."""
WARM_UP: Final = 64
"""Take the frames of starting trials from before time zero, in place of a period (numerical)."""
ALL_PHASES: Final = LIMIT | STORE | MOVE | EXPOSE | REPORT | JUDGE


class StepArrays(NamedTuple):
    """All arrays of a step of simulated heads, of which tables are made."""

    timing: SensorTiming
    packed: PackedConditions
    keys: StreamKeys
    scene: TrueHeadsAndTargets
    motors: MotorStates
    coupling: ActuatorCoupling | None
    commands: CommandBuffers
    feedback: JointFeedbackBuffers
    frames: Frames
    exposures: Exposures
    reading: Reading
    task: TaskArrays
    motion: tuple[Any, ...]
    """The plant's own arrays, for the phase in which it moves the joints."""


@subroutine
def begin_period(table: NDArray[np.void], ids: IntArray, phases: int) -> bool:
    """Run the phases before the joints move.

    Args:
        table: table of `StepArrays`.
        ids: (m,) environment indices.
        phases: the phases to run.

    Returns:
        False if an action or a command is nan.
    """
    own = StepArrays(*unpack_table(table))
    if phases & LIMIT and not limit_actions(ids, own.task):
        return False
    if phases & STORE:
        feedback, scene = JointFeedbackBuffers(*own.feedback), TrueHeadsAndTargets(*own.scene)
        return store_commands(
            ids,
            TaskArrays(*own.task).command,
            own.commands,
            feedback.control_loop_states,
            scene.step,
            Reading(*own.reading).command,
        )
    return True


@subroutine
def end_period(table: NDArray[np.void], ids: IntArray, phases: int) -> None:
    """Run the phases after the joints have moved; see `begin_period`."""
    own = StepArrays(*unpack_table(table))
    steps = TrueHeadsAndTargets(*own.scene).step
    if phases & MOVE:
        for n in ids:
            steps[n] += 1
    if phases & EXPOSE:
        simulate_detections(
            ids, own.timing, own.packed, own.keys, own.scene, own.exposures, own.frames
        )
    if phases & WARM_UP:
        while expose_frames_before_start(ids, own.packed, own.scene, own.frames, own.exposures):
            simulate_detections(
                ids, own.timing, own.packed, own.keys, own.scene, own.exposures, own.frames
            )
    if phases & REPORT:
        read_sensors(
            ids, own.timing, own.packed, own.keys, steps, own.motors,
            name_coupling(own.coupling), own.feedback, own.frames, own.reading,
        )  # fmt: skip
    if phases & JUDGE:
        judge_steps(ids, own.task, own.reading)
