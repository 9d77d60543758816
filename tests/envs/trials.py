"""Trials that begin where a test wants them to, and what was read in them."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from vergence.envs.plant import Plant, TrialStart, simulation_of
from vergence.envs.reading import Reading
from vergence.envs.targets.motion import motion_rows
from vergence.models import HeadModel

Array = NDArray[np.float64]
AHEAD = (0.0, -0.1, 1.0)


def start_of(
    num: int = 1,
    point: ArrayLike = AHEAD,
    before: ArrayLike | None = None,
    positions: ArrayLike = 0.0,
    seed: int = 0,
) -> TrialStart:
    """A trial each of some heads: a target at rest at `point`, at `before` until time zero."""
    points = np.broadcast_to(np.asarray(point, dtype=np.float64), (num, 3))
    angles = np.broadcast_to(np.asarray(positions, dtype=np.float64), (num, 7)).copy()
    ids, seeds = np.arange(num), np.full(num, seed, dtype=np.uint64)
    rows = motion_rows(points, before=before)
    return TrialStart(ids, seeds, ids.astype(np.uint64), angles, rows)


def begin(plant: Plant, start: TrialStart) -> Reading:
    """Begin trials on a simulated plant."""
    return simulation_of(plant).begin(start)


def steps(
    plant: Plant,
    start: TrialStart,
    count: int,
    command: ArrayLike | Callable[[int], ArrayLike] = 0.0,
) -> tuple[list[Reading], Array, Array]:
    """Readings, angles and velocities (count + 1, num, 7) of trials, from time zero on.

    The command is one that broadcasts to (num, 7), or a function of the step, rad/s.
    """
    readings, positions, velocities = [begin(plant, start).copy()], [], []

    def note() -> None:
        truth = simulation_of(plant).truth()
        positions.append(truth.positions)
        velocities.append(truth.velocities)

    note()
    for step in range(count):
        given = command(step) if callable(command) else command
        joint_velocity = np.broadcast_to(np.asarray(given, dtype=np.float64), (plant.num, 7))
        readings.append(plant.step(joint_velocity.copy()).copy())
        note()
    return readings, np.array(positions), np.array(velocities)


def assert_uniform(sample: ArrayLike) -> None:
    """Fail if numbers that should be uniform in 0 to 1 hardly are."""
    # far below what chance gives once in a thousand, and far above a wrong distribution's
    assert stats.kstest(sample, "uniform").pvalue > 1e-3


def pixels_of(head: HeadModel, q: Array, start: Array, point: ArrayLike = AHEAD) -> Array:
    """Pixels at angles q of a point that rests in frame 0, given in N as it stood at `start`."""
    carry = np.linalg.inv(head.base_pose(q)) @ head.base_pose(start)
    return head.project(q, (carry @ np.array([*point, 1.0]))[..., :3])
