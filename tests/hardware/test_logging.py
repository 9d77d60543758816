"""Log lines of a robot in simulated time: a few a trial, none a period, one for each stop."""

import logging

import numpy as np
import pytest

STILL = np.zeros((1, 7))


@pytest.fixture(autouse=True)
def all_lines(caplog):
    caplog.set_level(logging.DEBUG, "vergence")


@pytest.mark.slow
def test_a_period_says_nothing(robot, caplog):
    robot.begin()
    robot.plant.step(STILL)
    caplog.clear()
    for _ in range(70):  # more than a second
        robot.plant.step(STILL)
    assert caplog.records == []


@pytest.mark.slow
def test_missed_periods_are_told_once_a_second(robot, caplog):
    robot.begin()
    pause_s, begun_s = 2.2 * robot.plant.head.timing.period_s, robot.clock()
    while robot.clock() < begun_s + 1.5:
        for _ in range(8):
            robot.plant.step(STILL)
        robot.clock.stand_still(pause_s)
    assert robot.plant.overruns > 2
    told = [one.message for one in caplog.records if one.message.startswith("periods missed")]
    assert len(told) == 2


def test_a_stop_is_an_error_with_its_reason(robot, caplog):
    robot.begin()
    robot.plant.step(STILL)
    robot.fault(what="unplug")
    robot.plant.step(STILL)
    (error,) = [one for one in caplog.records if one.levelno == logging.ERROR]
    assert robot.plant.fault
    assert error.getMessage() == f"stopped: {robot.plant.fault}"
