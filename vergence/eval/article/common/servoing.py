"""Trials of the article's law side by side, each with its own gain and its own loop."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from vergence.controllers.ibvs import ibvs_command
from vergence.envs.targets.target import Target
from vergence.envs.task import GazeTask
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray


def servo(
    head: HeadModel,
    target: Target | Mapping[str, Any],
    gains: ArrayLike,
    *,
    duration_s: float,
    seed: int,
    first_trial: int = 0,
    plant: str = "kinematic",
    plant_options: Mapping[str, Any] | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Let the article's law turn heads to a target, see `vergence.controllers.ibvs`.

    Args:
        head: the model that the law knows.
        target: what all of them look at.
        gains: (n, 2) the gains k1 and k2 of each trial, 1/s.
        duration_s: how long the trials last.
        seed: seed of all noise.
        first_trial: number of the first trial; the others follow it.
        plant: what moves the heads.
        plant_options: the plant's own options, numbers or (n,) arrays.

    Returns:
        (steps,) seconds since time zero, and (steps, n, 2, 2) true pixel errors, px.
    """
    gain = np.asarray(gains, dtype=np.float64)
    num = len(gain)
    # by eye and image axis: both eyes have the same gains
    gain = np.repeat(gain[:, None, :], 2, axis=1)
    task = GazeTask(num, head=head, plant=plant, target=target, plant_options=plant_options)
    seeds = np.full(num, seed, dtype=np.uint64)
    trials = np.arange(first_trial, first_trial + num, dtype=np.uint64)
    task.begin(np.arange(num), seeds, trials)
    steps = round(duration_s * head.timing.control_rate_hz)
    limits = np.array(task.layout.action_limits)
    error = np.empty((steps + 1, num, 2, 2))
    error[0] = _true_error(task)
    for step in range(steps):
        seen = task.layout.decode(task.observation)
        command = ibvs_command(
            seen.positions_at_exposure, seen.pixel_error, gain, np.nan, limits, head.packed
        )
        task.step(task.layout.action(command))
        error[step + 1] = _true_error(task)
    task.close()
    time = np.asarray(np.arange(steps + 1) * head.timing.period_s)
    return time, error


def _true_error(task: GazeTask) -> FloatArray:
    truth = task.truth()
    assert truth is not None  # all plants of these experiments are simulated
    return truth.pixel_error
