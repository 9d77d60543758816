"""Compiling before motors have torque calls the kernels that the loop will call."""

import numpy as np
import pytest
from numba import typeof

from tests.hardware.fakes import HEAD, TAG
from tests.hardware.virtual import VirtualRobot
from vergence.controllers.controller import make_controller
from vergence.envs import plant
from vergence.envs import task as gaze_task
from vergence.hardware.cameras import compile_loop_kernels
from vergence.vision.tracking import Tracker


@pytest.mark.slow
def test_preparing_compiles_what_a_target_that_comes_later_needs(monkeypatch):
    seen, find = [], Tracker.find

    def watched(tracker, image, **pose):
        seen.append(find(tracker, image, **pose))
        return seen[-1]

    monkeypatch.setattr(Tracker, "find", watched)
    compile_loop_kernels(HEAD, TAG)
    # both eyes' boards are found and followed, and an image without one is searched
    assert [one is not None for one in seen] == [True, True, False] * 2


@pytest.mark.slow
def test_a_robots_trial_calls_the_task_with_types_that_preparing_has_compiled(monkeypatch):
    robot, types = VirtualRobot(monkeypatch), []
    advance = plant.advance_task

    def watched(*arguments):
        types.append(tuple(map(typeof, arguments)))
        return advance(*arguments)

    monkeypatch.setattr(plant, "advance_task", watched)
    monkeypatch.setattr(gaze_task, "make_plant", lambda *_arguments: robot.plant)
    task = gaze_task.GazeTask(1, head=HEAD, plant="hardware")
    task.prepare(make_controller("ibvs", head=HEAD))
    prepared = set(types)
    task.begin(np.arange(1), *np.zeros((2, 1), np.uint64))
    for _ in range(20):
        task.step(np.ones((1, task.layout.count)))
    assert task.reading.frame[0] > 0
    assert len(types) > 40
    assert set(types) == prepared
    task.close()
