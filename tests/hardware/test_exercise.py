"""A robot outside a trial, and at its very beginning: joints exercised, targets that appear."""

import numpy as np
import pytest

from tests.hardware.fakes import HEAD
from tests.hardware.virtual import VirtualRobot
from vergence.errors import HardwareError

SLOT = 3
STILL = np.zeros((1, 7))


def velocities(speed, count):
    for _ in range(count):
        requested = np.zeros(7)
        requested[SLOT] = speed
        yield requested


@pytest.mark.parametrize("appears", [False, True])
def test_a_target_that_appears_is_not_seen_in_images_of_before(monkeypatch, appears):
    robot = VirtualRobot(monkeypatch, plant_options={"appears": appears})
    robot.begin()
    assert robot.plant.reading.visible.any() == (not appears)
    while not robot.plant.reading.visible.any() or robot.plant.reading.exposure_s[0] < 0.0:
        robot.plant.step(STILL)
        assert robot.plant.reading.time_s[0] < 0.5
    timing = HEAD.timing
    assert robot.plant.reading.time_s[0] > timing.latency_s - timing.period_s


@pytest.mark.slow
def test_joints_are_exercised_within_the_bounds_and_rest_afterwards(robot):
    robot.begin()
    robot.plant.robot.exercise(velocities(0.15, 60))
    assert robot.world.servos["left_pan"].q == pytest.approx(0.15, abs=0.02)
    robot.plant.robot.exercise(velocities(50.0, 60))  # towards the limit, which it does not reach
    now = robot.clock()
    robot.clock.sleep(0.5)
    assert robot.rested_s(now) < 0.3
    assert 1.0 < robot.world.servos["left_pan"].q <= 1.4


def test_what_stops_a_robot_that_is_exercised_stays_its_fault(robot):
    robot.begin()

    def until_the_cable_is_pulled():
        yield from velocities(0.15, 10)
        robot.fault(what="unplug")
        yield from velocities(0.15, 10)

    with pytest.raises(HardwareError, match="the serial line is gone"):
        robot.plant.robot.exercise(until_the_cable_is_pulled())
    assert "the serial line is gone" in robot.plant.fault
