"""The recorder: rows are what the task reported, and no more is kept than is asked for."""

import numpy as np
import pytest

from vergence.controllers import make_controller
from vergence.envs.plant import PLANTS
from vergence.envs.reading import Reading, Truth
from vergence.envs.task import GazeTask, rollout
from vergence.errors import VergenceWarning
from vergence.models.head_file import load_head
from vergence.recording import Recorder
from vergence.recording.events import MAX_GAP_RATIO, LoopHealth, warn_of_gap

STEPS = 20


def run(task, keep, steps=STEPS):
    rollout(task, make_controller("ibvs", head=task.head), steps, keep, seed=3)


def recorded(task):
    """A record of a law's trials, and copies of what the task reported in each step."""
    record, told = Recorder(task, STEPS), []

    def keep(step):
        record(step)
        truth = task.truth()
        truth = None if truth is None else Truth(*(part.copy() for part in truth))
        told.append((task.reading.copy(), truth, task.pixel_error.copy(), task.lost.copy()))

    run(task, keep)
    return record, told


@pytest.fixture
def task():
    return GazeTask(3, plant="kinematic", target="random")


@pytest.fixture
def robot(monkeypatch):
    monkeypatch.setitem(PLANTS, "robot", "tests.envs.robot:Robot")
    return GazeTask(1, plant="robot", target="static")


def same(rows, told):
    return all(
        np.array_equal(part, np.stack(now), equal_nan=True) and part.dtype == now[0].dtype
        for part, now in zip(rows, zip(*told, strict=True), strict=True)
    )


def test_rows_are_what_the_task_reported_in_each_step(task):
    record, told = recorded(task)
    readings, truths, *others = zip(*told, strict=True)
    assert record.reading.pixels.shape == (STEPS + 1, 3, 2, 2)
    assert same(record.reading, readings)
    assert same(record.truth, truths)
    assert same((record.pixel_error, record.lost), zip(*others, strict=True))
    # the eyes moved: a row is none of another step
    assert (np.ptp(record.reading.positions[:, :, 3:], axis=0) > 0.0).all()


def test_fields_that_are_not_asked_for_have_no_rows_nor_truth(task, monkeypatch):
    record = Recorder(task, STEPS, reading=("positions",), truth=("target",))
    run(task, record)
    assert [name for name in Reading._fields if len(getattr(record.reading, name))] == ["positions"]
    assert [name for name in Truth._fields if len(getattr(record.truth, name))] == ["target"]
    assert not len(record.pixel_error)
    record = Recorder(task, STEPS, truth=())
    monkeypatch.setattr(task, "truth", lambda: pytest.fail("asked"))
    record(0)
    assert record.truth is None


def test_truth_that_is_unknown_once_is_none(task, monkeypatch):
    record, truth = Recorder(task, STEPS), task.truth

    def keep(step):
        monkeypatch.setattr(task, "truth", truth if step < 5 or step > 8 else lambda: None)
        record(step)

    run(task, keep)
    assert record.truth is None
    assert len(record.reading.positions) == STEPS + 1


def test_a_robot_has_no_truth_and_a_trial_that_ended_early_as_many_rows_as_were_recorded(robot):
    record, told = recorded(robot)
    assert record.truth is None
    assert same(record.reading, [reading for reading, *_others in told])
    record = Recorder(robot, STEPS)
    run(robot, record, 7)
    assert (len(record.reading.positions), len(record.lost)) == (8, 8)


HEAD = load_head("simulated").replace(sensor={"detection_noise_px": 0.3})
POINT = np.array([0.05, -0.05, 1.0])


def readings(count, *, right_down_px=0.0, speed_rad_s=0.0, seed=0):
    """Readings of a still head with noisy pixels, a new image in each period."""
    rng, q = np.random.default_rng(seed), HEAD.fixate(POINT)
    for step in range(count):
        time_s = np.float64(HEAD.timing.period_s * step)
        pixels = HEAD.project(q, POINT) + rng.normal(0.0, 0.3, (2, 2))
        pixels[1, 1] += right_down_px
        yield Reading._make(part[0] for part in Reading.empty(1))._replace(
            time_s=time_s, exposure_s=time_s - HEAD.timing.latency_s, pixels=pixels,
            visible=np.ones(2, bool), positions_at_exposure=q, velocities=np.full(7, speed_rad_s),
        )  # fmt: skip


def judged(some):
    health = LoopHealth(HEAD)
    for reading in some:
        health.add(reading)
    return health


@pytest.mark.slow
def test_noise_alone_is_not_reported():
    ratios = [judged(readings(40, seed=seed)).gap_ratio for seed in range(8)]
    assert 0.7 < np.median(ratios) < 1.3
    assert max(ratios) < MAX_GAP_RATIO


def test_a_camera_that_has_moved_is_reported():
    health = judged(readings(40, right_down_px=5.0))
    assert health.gap_ratio > MAX_GAP_RATIO
    assert any("warning" in line and "camera" in line for line in health.words())
    # gaps of moving eyes are not judged
    assert np.isnan(judged(readings(40, right_down_px=5.0, speed_rad_s=0.5)).gap_ratio)
    rows = zip(*readings(40, right_down_px=5.0), strict=True)
    with pytest.warns(VergenceWarning, match="a zero .* or a camera is off"):
        warn_of_gap(HEAD, Reading._make(np.stack(part)[:, np.newaxis] for part in rows))


def test_missed_periods_are_counted_within_a_gaze():
    some = list(readings(10))
    health = judged([*some[:4], *some[6:], *some[:5]])
    assert health.missed_periods == 2
    assert health.periods == 9 + 4


def test_a_gaze_is_judged_though_the_eyes_moved_later_in_the_one_before():
    moving = readings(40, speed_rad_s=0.5)
    health = judged([*moving, *readings(40, right_down_px=5.0)])
    assert health.gap_ratio > MAX_GAP_RATIO
