"""The recorder: rows are what the task reported, and no more is kept than is asked for."""

import numpy as np
import pytest

from vergence.controllers import make_controller
from vergence.envs.plant import PLANTS
from vergence.envs.reading import Reading, Truth
from vergence.envs.task import GazeTask, rollout
from vergence.recording import Recorder

STEPS = 20


def recorded(task, **fields):
    """A record of a law's trials, and copies of what the task reported in each step."""
    record, told = Recorder(task, STEPS, **fields), []

    def keep(step):
        record(step)
        truth = task.truth()
        told.append((
            task.reading.copy(), None if truth is None else Truth(*(part.copy() for part in truth)),
            task.pixel_error.copy(), task.lost.copy(),
        ))  # fmt: skip

    rollout(task, make_controller("ibvs", head=task.head), STEPS, keep, seed=3)
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
    record, _told = recorded(task, reading=("positions",), truth=("target",))
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

    rollout(task, make_controller("ibvs", head=task.head), STEPS, keep, seed=3)
    assert record.truth is None
    assert len(record.reading.positions) == STEPS + 1


def test_a_robot_has_no_truth_and_a_trial_that_ended_early_as_many_rows_as_were_recorded(robot):
    record, told = recorded(robot)
    assert record.truth is None
    assert same(record.reading, [reading for reading, *_others in told])
    record = Recorder(robot, STEPS)
    rollout(robot, make_controller("ibvs", head=robot.head), 7, record)
    assert (len(record.reading.positions), len(record.lost)) == (8, 8)
