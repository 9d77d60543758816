"""The time-optimal bound: exact for a joint, and never beaten by anything that moves one."""

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.eval.trials import oracle
from tests.eval.trials.oracle import begin
from tests.heads import MOVING, head_of
from tests.joint_motion import respond
from tests.naming import named
from vergence.envs.plant import TrialStart
from vergence.envs.targets.motion import motion_rows
from vergence.envs.task import GazeTask
from vergence.errors import ConfigurationError
from vergence.eval.trials.bound import settle_bound
from vergence.eval.trials.entry import least_entry_time
from vergence.eval.trials.goal import least_reachable_error
from vergence.eval.trials.metrics import settle_time
from vergence.eval.trials.scenarios import load_scenario

Array = NDArray[np.float64]
PERIOD = 1 / 120
BAND_RAD = 1 / 620
"""One pixel of the simulated eyes."""


@pytest.mark.slow
def test_a_joint_of_the_default_rig_stops_on_its_target_in_these_times():
    for degrees, milliseconds in {5: 54.0, 10: 77.0, 20: 113.0, 30: 145.0}.items():
        angle = np.deg2rad(degrees)
        stop = least_entry_time(angle - 1e-9, angle, 0.03, 120.0, 6.0, 0.0)
        assert 1e3 * stop == pytest.approx(milliseconds, abs=0.5)
        enter = least_entry_time(angle - BAND_RAD, angle + BAND_RAD, 0.03, 120.0, 6.0, 0.0)
        assert 5.0 <= 1e3 * (stop - enter) <= 7.1


@pytest.mark.slow
def test_brute_force_over_all_switch_times_finds_nothing_faster() -> None:
    for case in [
        (0.01, 0.03, 120.0),
        (0.17, 0.06, 120.0),  # the lag forbids the greatest deceleration below 1.2 rad/s
        (0.2, 0.05, np.inf),
    ]:
        with named(case):
            angle, lag, acceleration = case
            near, far = angle - BAND_RAD, angle + BAND_RAD
            got = least_entry_time(near, far, lag, acceleration, 6.0, 0.0)
            step, entered, furthest = every_switch(near, lag, acceleration)
            best = entered[furthest <= far].min()
            # the best switch lies between two of the grid, one of which stops short of the far edge
            # and the other beyond it, by no more than a step at full speed there and back
            too_late = entered[furthest <= far + 2 * 6.0 * step].min()
            assert too_late - step - 1e-9 <= got <= best
            assert best - too_late < 0.003


def every_switch(near: float, lag: float, acceleration: float) -> tuple[float, Array, Array]:
    """Joints that reverse at every time of a grid, each followed through tiny periods.

    The grid's step; when each joint enters the band, s, and how far it gets, rad.
    """
    step = 2e-4
    switch = np.arange(0.0, 0.1, step)
    num = len(switch)
    q, v = np.zeros((2, num))
    entered, furthest = np.full(num, np.inf), np.zeros(num)
    stopped = np.zeros(num, dtype=bool)
    for k in range(2500):
        command = np.where(k * step < switch - step / 2, 6.0, -6.0)
        q, v = respond(q, v, command, lag, acceleration, step)
        entered = np.where((q >= near) & ~stopped, np.minimum(entered, (k + 1) * step), entered)
        furthest = np.where(stopped, furthest, np.maximum(furthest, q))
        stopped |= (v <= 0.0) & (k * step > switch)
        if stopped.all():
            break
    assert stopped.all()
    return step, entered, furthest


def test_the_grid_of_bounds_is_whole_periods_after_the_delay() -> None:
    scenario = load_scenario("robust")
    task = begin(scenario.task(300), scenario.seed("test"))
    bound = settle_bound(task)
    conditions = task.plant.conditions
    assert conditions is not None
    periods = bound / PERIOD
    assert periods == pytest.approx(np.round(periods), abs=1e-9)
    # the image of time zero is read at the first control step after its latency
    motion = np.round(periods) - np.ceil(conditions.latency_s / PERIOD)
    assert motion.min() >= 1
    # and the joints' own lag counts: slow joints take longer for the same turns
    slow = conditions.lag_s > np.median(conditions.lag_s)
    assert motion[slow].mean() > motion[~slow].mean()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "plant", "beyond_px"), [("workspace", "mujoco", 0.6), ("robust", "kinematic", 0.5)]
)
def test_an_oracle_meets_the_bound_within_a_period_and_never_beats_it(name, plant, beyond_px):
    scenario = load_scenario(name)
    task = begin(scenario.task(20, plant), scenario.seed("validation"))
    bound = settle_bound(task)
    time, error = oracle.run(task, 80, beyond_px)
    late = np.round((settle_time(time, error, 1.0) - bound) / PERIOD)
    assert (late >= 0).all()  # nan, a trial that did not settle, fails too
    # commands that hold for a period cannot switch where they would like to
    assert (late <= 1).all()
    assert (late == 0).mean() > 0.4


@pytest.mark.nightly
def test_an_oracle_meets_the_bound_of_any_head() -> None:
    lates = []
    for number, shape in enumerate(MOVING):
        with named(shape):
            described = load_scenario(("workspace", "robust")[number % 2])
            task = begin(described.task(6, head=head_of(shape)), described.seed("validation"))
            bound, least = settle_bound(task), least_reachable_error(task, task.truth().target)
            time, error = oracle.run(task, 80, 0.5)
            late = np.round((settle_time(time, error - least, 1.0) - bound) / PERIOD)
            assert (late >= 0).all()
            # an actuator that is nearly there may wait for the other eye's: a relaxed band
            assert (late <= 2).all()
            lates.append(late)
    assert (np.concatenate(lates) <= 1).mean() > 0.9


def test_eyes_that_look_there_already_need_no_time() -> None:
    task = begin(GazeTask(2, plant="kinematic", target={"kind": "step", "after": (0, -0.1, 1)}), 0)
    assert settle_bound(task).tolist() == [0.0, 0.0]


def test_a_joint_that_just_misses_the_band_needs_a_period_after_the_delay() -> None:
    # 1.5 px: within what the wide relaxation would forgive a joint, but not within the circle
    for height in (0.0017, 0.0024):
        target = {"kind": "step", "after": (0.0, -0.1 - height, 1.0)}
        task = begin(GazeTask(1, plant="kinematic", target=target), 0)
        assert settle_bound(task)[0] >= (8 + 1) * PERIOD - 1e-12


def test_a_band_beyond_a_joints_range_cannot_be_entered() -> None:
    task = begin(GazeTask(1, plant="kinematic", target="static"), 0)
    # 67 degrees down, 6 beyond the limit: no target of the task stands there
    beyond = motion_rows((0.0, 1.2, 0.5))
    zero = np.zeros(1, dtype=np.uint64)
    start = TrialStart(np.arange(1), zero, zero, task.head.rest()[None], beyond)
    task.plant.begin(start)
    assert settle_bound(task)[0] == np.inf


def test_the_end_of_a_joints_range_brakes_it_for_nothing() -> None:
    # a joint that need not stop by itself enters as if nothing came behind
    near = 0.3
    free = least_entry_time(near, np.inf, 0.03, 120.0, 6.0, 0.0)
    assert free < least_entry_time(near, near + 2 * BAND_RAD, 0.03, 120.0, 6.0, 0.0) - 0.01
    # 20 ms at the limit, then the exponential: q + lag v advances at 6 rad/s once unclamped
    q, _v = respond(0.0, 0.0, 6.0, 0.03, 120.0, free)
    assert q == pytest.approx(near, abs=1e-9)


def test_only_trials_at_time_zero_of_a_simulation_have_a_bound() -> None:
    task = begin(GazeTask(1, plant="kinematic"), 0)
    with pytest.raises(ConfigurationError, match="band_px: expected more than 0, got 0"):
        settle_bound(task, 0)
    task.step(np.zeros((1, 4)))
    with pytest.raises(ConfigurationError, match=r"time zero, got one at 0\.008 s"):
        settle_bound(task)
