"""An adapter that holds answers back: what fits the period runs, all else is refused or told."""

import numpy as np
import pytest

from vergence.hardware.dynamixel.checks import cycle_timeout_s

STILL = np.zeros((1, 7))


@pytest.mark.slow
def test_answers_that_come_within_the_period_are_waited_for(robot):
    robot.world._answer_latency_s = 0.008
    robot.begin()
    for _ in range(60):
        robot.plant.step(STILL)
    assert robot.plant.fault == ""
    assert robot.plant.diagnostics()["missed_answers"] == 0


@pytest.mark.parametrize("latency_s", [0.0, 0.006])
def test_a_reading_is_dated_at_its_request(robot, latency_s):
    robot.world._answer_latency_s = latency_s
    robot.begin()
    speed = np.zeros((1, 7))
    speed[0, 3] = 1.0
    for _ in range(20):
        reading = robot.plant.step(speed)
    told_s = reading.joints_s[0] + robot.plant.begun_s
    trace = robot.world.servos["left_pan"].trace.samples_since(told_s)
    # half a tick, and what it turns within the request's 0.2 ms
    assert reading.positions[0, 3] == pytest.approx(trace[0].position_rad, abs=1.2e-3)


def test_a_timeout_leaves_time_in_the_period():
    assert cycle_timeout_s(0.0, 1 / 60) == 0.006
    assert cycle_timeout_s(0.008, 1 / 60) == pytest.approx(0.012)
    assert cycle_timeout_s(0.016, 1 / 60) == pytest.approx(0.75 / 60)
