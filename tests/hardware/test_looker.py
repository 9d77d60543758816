"""A robot that looks at a board, in simulated time: how near it goes, and when it looks."""

import numpy as np
import pytest

from tests.hardware.fakes import HEAD, TAG
from vergence.errors import HardwareError
from vergence.hardware import robot as module
from vergence.hardware.robot import RobotLooker


@pytest.fixture
def looker(monkeypatch, robot):
    monkeypatch.setattr(module, "load_hardware", lambda _path: robot.plant.config)
    monkeypatch.setattr(module, "Robot", lambda _config, view_check: robot.plant.robot)
    return RobotLooker("robot.toml", TAG)


def turned(*eyes):
    return HEAD.rest() + np.array([0, 0, 0, *eyes])


def angles(robot):
    return np.array(robot.world.state(robot.clock())["positions"])


@pytest.mark.slow
def test_a_turn_of_some_milliradians_is_made(robot, looker):
    for way in (0.0, 0.005, -0.002):
        q = turned(0.2 + way, -0.1, 0.1, 0.1 - way)
        sight = looker.look(q)
        assert np.abs(angles(robot) - q).max() < 0.0035
        assert np.abs(sight.positions - angles(robot)).max() < 0.0016


@pytest.mark.slow
def test_what_is_seen_was_exposed_at_rest_after_the_look_was_asked_for(robot, looker):
    for pan in (0.3, -0.3, -0.301):
        asked_s = robot.clock()
        sight = looker.look(turned(pan, 0, 0, 0))
        assert sight.time_s > asked_s + robot.rested_s(asked_s)
        assert sight.corners_px == (None, None)  # these eyes see the measured point alone


@pytest.mark.slow
def test_an_eye_without_images_is_said_and_stops_nothing(robot, looker):
    looker.look(turned(0, 0, 0, 0))
    robot.eyes[1].stalled_s = robot.clock()
    with pytest.raises(HardwareError, match="expected images of both eyes at rest"):
        looker.look(turned(0.1, 0, 0, 0))
    robot.eyes[1].stalled_s = np.inf
    looker.look(turned(0.1, 0, 0, 0))


def test_a_robot_that_was_stopped_says_why_at_each_look(robot, looker):
    robot.fault(what="unplug")
    for more in ("", ".* has been stopped"):
        with pytest.raises(HardwareError, match="the serial line is gone" + more):
            looker.look(turned(0.1, 0, 0, 0))
