"""A trial is the same alone, in a vector, after other trials and on any number of workers."""

import numpy as np
import pytest

from vergence import load_head
from vergence.envs.task import GazeTask

SEED, TRIAL = 11, 5


def actions(count: int) -> np.ndarray:
    """Fixed actions for every run: observations must not depend on anything else."""
    steps = np.arange(count)[:, None]
    return 0.3 * np.sin(0.13 * steps + np.array([0.0, 1.0, 2.0, 3.0]))


def keys(num: int, place: int):
    """Seeds and trials of a batch in which the trial under test has one place."""
    seeds, trials = np.arange(50, 50 + num, dtype=np.uint64), np.arange(num, dtype=np.uint64)
    seeds[place], trials[place] = SEED, TRIAL
    return seeds, trials


def now(task: GazeTask, place: int) -> tuple[np.ndarray, ...]:
    numbers = (*task.reading, *task.truth(), task.observation, task.reward)
    return tuple(array[place].copy() for array in numbers)


def record(task: GazeTask, place: int, count: int) -> list[tuple[np.ndarray, ...]]:
    """Everything that one place's readings, truths and observations say over some steps."""
    out = [now(task, place)]
    for action in actions(count):
        task.step(np.broadcast_to(action, (task.num, 4)).copy())
        out.append(now(task, place))
    return out


def identical(a, b) -> bool:
    return all(
        np.array_equal(x, y, equal_nan=x.dtype.kind == "f")
        for row, other in zip(a, b, strict=True)
        for x, y in zip(row, other, strict=True)
    )


NOISY = load_head("physical").replace(sensor={"dropped_frame_probability": 0.1})
"""Every source of randomness and rounding at once."""


# longer than a block of random numbers, which is 256 steps
CASES = [
    ("kinematic", 270, 7, "random"), ("mujoco", 60, 3, "step"),
    pytest.param("rendered", 14, 2, "step", marks=pytest.mark.slow),
]  # fmt: skip


@pytest.mark.parametrize(("plant", "count", "num", "target"), CASES)
def test_a_trial_is_the_same_alone_and_among_earlier_and_later_ones(plant, count, num, target):
    task = GazeTask(1, head=NOISY, plant=plant, target=target)
    task.begin(np.arange(1), *keys(1, 0))
    expected = record(task, 0, count)
    task = GazeTask(num, head=NOISY, plant=plant, target=target)
    seeds, trials = keys(num, 1)
    task.begin(np.arange(num), seeds + np.uint64(1), trials)
    ran = record(task, 1, 10)
    task.begin(np.array([1]), seeds[[1]], trials[[1]])
    ran = record(task, 1, 12)
    others = np.flatnonzero(np.arange(num) != 1)
    task.begin(others, seeds[others], trials[others] + np.uint64(9))
    for action in actions(count)[12:]:
        task.step(np.broadcast_to(action, (num, 4)).copy())
        ran.append(now(task, 1))
    assert identical(ran, expected)


def test_a_neighbour_with_a_longer_delay_changes_nothing() -> None:
    runs = []
    for latencies in ([8 / 120, 8 / 120], [8 / 120, 0.1]):
        options = {"latency_s": latencies}
        task = GazeTask(2, head=NOISY, plant="kinematic", target="step", plant_options=options)
        task.begin(np.arange(2), *keys(2, 0))
        runs.append(record(task, 0, 40))
    assert identical(*runs)
