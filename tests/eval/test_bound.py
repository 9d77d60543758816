"""The time-optimal bound: exact for a joint, and never beaten by anything that moves one."""

import numpy as np
import pytest
from numpy.typing import NDArray

from vergence.envs.actuation import follow
from vergence.envs.task import GazeTask
from vergence.eval.bound import fastest_entry, settle_bound
from vergence.eval.scenarios import load_scenario

Array = NDArray[np.float64]
PERIOD = 1 / 120
BAND_RAD = 1 / 620
"""One pixel of the simulated eyes."""


def begin(task: GazeTask, seed: int) -> GazeTask:
    trials = np.arange(task.num, dtype=np.uint64)
    task.begin(np.arange(task.num), np.full(task.num, seed, np.uint64), trials)
    return task


@pytest.mark.parametrize(
    ("degrees", "milliseconds"), [(5, 54.0), (10, 77.0), (20, 113.0), (30, 145.0)]
)
def test_a_joint_of_the_default_rig_stops_on_its_target_in_these_times(degrees, milliseconds):
    angle = np.deg2rad(degrees)
    stop = fastest_entry(angle - 1e-9, angle, 0.03, 120.0, 6.0)
    assert 1e3 * stop == pytest.approx(milliseconds, abs=0.5)
    enter = fastest_entry(angle - BAND_RAD, angle + BAND_RAD, 0.03, 120.0, 6.0)
    assert 5.0 <= 1e3 * (stop - enter) <= 7.1


@pytest.mark.parametrize(
    ("angle", "lag", "acceleration"),
    [
        (0.17, 0.03, 120.0),
        (0.5, 0.03, 120.0),
        (0.01, 0.03, 120.0),
        (0.17, 0.06, 120.0),  # the lag forbids the greatest deceleration below 1.2 rad/s
        (0.4, 0.015, 120.0),
        (0.2, 0.1, 120.0),  # so slow that the acceleration limit hardly matters
        (0.2, 0.05, np.inf),
        (0.2, 0.0, 120.0),
    ],
)
def test_brute_force_over_all_switch_times_finds_nothing_faster(angle, lag, acceleration) -> None:
    # every switch of a fine grid at once, each a joint followed through tiny periods
    step, count = 5e-5, 10000
    switch = np.arange(0.0, 0.2, step)
    num = len(switch)
    q, v = np.zeros((2, num, 7))
    lags, free = np.full(num, lag), np.full(7, 1e9)
    near, far = angle - BAND_RAD, angle + BAND_RAD
    entered, furthest = np.full(num, np.inf), np.zeros(num)
    stopped = np.zeros(num, dtype=bool)
    for k in range(count):
        command = np.zeros((num, 7))
        command[:, 0] = np.where(k * step < switch - step / 2, 6.0, -6.0)
        follow(q, v, command, lags, np.full(7, acceleration), -free, free, step)
        entered = np.where(
            (q[:, 0] >= near) & ~stopped, np.minimum(entered, (k + 1) * step), entered
        )
        furthest = np.where(stopped, furthest, np.maximum(furthest, q[:, 0]))
        stopped |= (v[:, 0] <= 0.0) & (k * step > switch)
        if stopped.all():
            break
    assert stopped.all()
    best = entered[furthest <= far].min()
    got = fastest_entry(near, far, lag, acceleration, 6.0)
    # the best switch lies between two of the grid, one of which stops short of the far edge and
    # the other beyond it, by no more than a step at full speed there and back
    too_late = entered[furthest <= far + 2 * 6.0 * step].min()
    assert too_late - step - 1e-9 <= got <= best
    assert best - too_late < 0.001


def test_the_grid_of_bounds_is_whole_periods_after_the_delay() -> None:
    scenario = load_scenario("robust")
    task = begin(scenario.task(300), scenario.seed("test"))
    bound = settle_bound(task)
    conditions = task.plant.conditions
    assert conditions is not None
    periods = bound / PERIOD
    assert periods == pytest.approx(np.round(periods), abs=1e-9)
    motion = np.round(periods).astype(int) - conditions.latency_frames
    assert motion.min() >= 1
    # and the joints' own lag counts: slow joints take longer for the same turns
    slow = conditions.lag_s > np.median(conditions.lag_s)
    assert motion[slow].mean() > motion[~slow].mean()
