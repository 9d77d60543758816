"""The bound of a robot's loop: late, jittering, with faults, gains and falling torque."""

import dataclasses

import numpy as np
import pytest

from tests.eval.trials import oracle
from tests.eval.trials.oracle import begin
from vergence import make_controller
from vergence.envs.plant import simulation_of
from vergence.envs.task import GazeTask
from vergence.eval.trials.bound import settle_bound
from vergence.eval.trials.metrics import settle_time
from vergence.eval.trials.run import run_trials
from vergence.eval.trials.scenarios import load_scenario


def task_of(name: str, num: int, plant: str = "kinematic", **varied: object) -> GazeTask:
    scenario = load_scenario(name)
    variation = dataclasses.replace(scenario.variation, **varied)
    scenario = dataclasses.replace(scenario, variation=variation)
    head = scenario.model()
    if "backlash_rad" in varied:
        head = head.replace(sensor={"backlash_rad": 0.0})
    return begin(scenario.task(num, plant, head), scenario.seed("validation"))


def lateness(task: GazeTask, beyond_px: float = 1.0) -> np.ndarray:
    """(n,) by how many periods an oracle is later than the bound in the trials that just began."""
    period = task.head.timing.period_s
    bound, onset_s = settle_bound(task, 2.0), simulation_of(task.plant).onset_s()
    time, error = oracle.run(task, int(1.6 / period), beyond_px)
    late = (settle_time(time, error, 2.0) - onset_s - bound) / period
    # both end at control steps; nan is a trial that did not settle
    assert late == pytest.approx(np.round(late), abs=1e-6, nan_ok=True)
    return np.round(late)


@pytest.mark.nightly
def test_an_oracle_comes_within_periods_of_the_bound_and_never_below() -> None:
    task = task_of("webcam", 20, "mujoco", backlash_rad=None, torque_falloff=(0.0, 0.5))
    late = lateness(task)
    assert (late >= 0).all()  # nan, a trial that did not settle, fails too
    # commands that hold for a period and have steps cannot switch where they would like to
    assert (late <= 4).all()
    assert (late <= 2).mean() >= 0.95
    assert (late == 0).mean() > 0.4


@pytest.mark.slow
def test_with_play_an_oracle_comes_as_near_and_never_below() -> None:
    # a motor that has passed its goal comes back, and leaves its joint beyond
    late = lateness(task_of("hardware", 20, torque_falloff=(0.0, 0.5)), 0.5)
    assert (late >= 0).all()
    assert (late <= 2).mean() >= 0.9


@pytest.mark.slow
@pytest.mark.parametrize(("plant", "target"), [("kinematic", "random"), ("mujoco", "step")])
def test_the_first_sight_is_when_the_target_is_seen_first(plant, target) -> None:
    faults = {
        "latency_s": (0.03, 0.13), "jitter_s": (0.0, 0.05), "frame_rate_hz": (15.0, 150.0),
        "frame_phase": (0.0, 1.0), "clock_drift": (-0.01, 0.01),
        "dropped_frame_probability": (0.0, 0.5), "missed_detection_probability": (0.0, 0.7),
        "onset_s": (0.0, 0.3),
    }  # fmt: skip
    num = 60
    task = begin(GazeTask(num, plant=plant, target=target, variation=faults), 3)
    simulation = simulation_of(task.plant)
    sights, _last = simulation.first_detection_times()
    onset_s = simulation.onset_s()
    found = np.full(num, np.nan)
    for _ in range(240):
        task.step(np.zeros((num, 4)))
        reading = task.reading
        seen = reading.visible.any(axis=1) & np.isnan(found)
        if target == "step":
            aside = np.abs(reading.pixels - before(task)).max(axis=-1)
            seen &= (aside > 5.0).any(axis=1)
        found[seen] = reading.time_s[seen]
    period = task.head.timing.period_s
    assert (sights > onset_s + simulation.conditions.latency_s - 1e-9).all()
    # frames faster than control hide one another: the newest may be one that missed it
    late = (found - np.ceil(sights / period - 1e-6) * period) / period
    assert (late > -1e-6).all()
    slow = simulation.conditions.frame_rate_hz * 1.02 < 1.0 / period
    jitter = simulation.conditions.jitter_s * simulation.conditions.frame_rate_hz < 0.9
    assert late[slow & jitter] == pytest.approx(0.0, abs=1e-6)
    assert (slow & jitter).sum() > 10


def before(task: GazeTask) -> np.ndarray:
    """(n, 2, 2) where the eyes at rest see the target before its jump, px."""
    return task.head.project(task.reading.positions, (0.0, -0.1, 1.0))


def test_the_bound_rises_by_a_period_with_each_period_of_latency() -> None:
    lates = np.linspace(0.02, 0.05, 61)
    period = 1 / 120
    target = {"kind": "step", "before": (0.0, -0.1, 1.0), "after": (0.1, -0.2, 1.0)}
    for latency in ("latency_s", "command_latency_s"):
        bounds = []
        for more in (0.0, period):
            options = {latency: lates + more, "frame_phase": 0.4, "frame_rate_hz": 50.0}
            task = GazeTask(61, plant="kinematic", target=target, plant_options=options)
            bounds.append(settle_bound(begin(task, 0)))
        assert bounds[1] - bounds[0] == pytest.approx(period, abs=1e-9), latency
        # in between it is a staircase whose steps are whole periods
        stairs = np.diff(bounds[0]) / period
        assert stairs == pytest.approx(np.round(stairs), abs=1e-6)
        assert 2.5 < stairs.sum() < 4.5
        assert (stairs > -1e-6).all()


def test_the_bound_counts_from_the_onset() -> None:
    tasks = [
        begin(GazeTask(20, plant="kinematic", plant_options={"onset_s": onset_s}), 0)
        for onset_s in (0.0, 0.3, 0.3 + 1 / 240)
    ]
    bounds = [settle_bound(task) for task in tasks]
    assert bounds[1] == pytest.approx(bounds[0], abs=1e-9)
    # in the middle of two frames, a half of a period passes until the next
    assert bounds[2] == pytest.approx(bounds[0] + 1 / 240, abs=1e-9)


def bounds_of(name: str, values: tuple[float, ...], band_px: float) -> list[np.ndarray]:
    tasks = [GazeTask(60, plant="kinematic", plant_options={name: value}) for value in values]
    return [settle_bound(begin(task, 0), band_px) for task in tasks]


def test_a_stronger_motor_is_never_slower() -> None:
    for name in ("speed_gain", "acceleration_ratio"):
        bounds = bounds_of(name, (0.5, 0.8, 1.0, 1.2), 1.0)
        assert (np.diff(bounds, axis=0) <= 1e-9).all(), name
        assert (bounds[0] > bounds[-1] + 1e-3).mean() > 0.5, name


def test_what_hinders_a_motor_never_makes_it_faster() -> None:
    values = {"torque_falloff": (0.0, 0.4, 0.8), "backlash_rad": (0.0, 0.02), "lag_s": (0.02, 0.06)}
    for name in values:
        bounds = bounds_of(name, values[name], 2.0)
        if name != "backlash_rad":
            assert (np.diff(bounds, axis=0) >= -1e-9).all(), name
        # play leaves a joint beside its motor at first, which may be nearer to the target
        assert (bounds[-1] > bounds[0] - 0.01).all(), name
        assert (bounds[-1] > bounds[0] + 1e-3).mean() > 0.1, name


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("name", "scenario"),
    [
        ("saccade", "step"), ("learned-policy", "workspace"), ("pursuit", "robust"),
        ("delay-compensated", "hardware"), ("pid", "webcam"), ("pursuit", "double-step"),
    ],
)  # fmt: skip
def test_no_controller_beats_the_bound(name: str, scenario: str) -> None:
    described = load_scenario(scenario)
    trials = run_trials(
        make_controller(name, described.model()), described, episodes=24, split="validation"
    )
    for settled, bound in (
        (trials.settle_s(), trials.bound_s),
        (trials.settle_s(2.0), trials.bounds_s[2.0]),
    ):
        done = np.isfinite(settled)
        assert (settled[done] >= bound[done] - 1e-9).all()
    if scenario != "robust":
        assert np.isfinite(trials.settle_s(2.0)).any()
    assert (trials.bounds_s[2.0] <= trials.bound_s + 1e-9).all()
    assert np.isfinite(trials.bound_s).mean() > 0.9
