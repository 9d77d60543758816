"""An adapter that holds answers back: what fits the period runs, all else is refused or told."""

import numpy as np
import pytest

from tests.hardware.virtual import VirtualRobot
from vergence.errors import ChecksFailedError
from vergence.hardware.checks.line import cycle_timeout_s

STILL = np.zeros((1, 7))


@pytest.fixture
def robot(monkeypatch):
    return VirtualRobot(monkeypatch)


@pytest.mark.parametrize("latency_s", [0.004, 0.008])
def test_answers_that_come_within_the_period_are_waited_for(robot, latency_s):
    robot.world._answer_latency_s = latency_s
    robot.begin()
    for _ in range(60):
        robot.plant.step(STILL)
    assert robot.plant.fault == ""
    assert robot.plant.diagnostics()["missed_answers"] == 0


def test_answers_that_come_too_late_for_the_period_are_refused_with_a_rate_that_works(robot):
    robot.world._answer_latency_s = 0.016
    with pytest.raises(ChecksFailedError) as refused:
        robot.plant.prepare()
    (line,) = refused.value.lines
    assert "of the control period of 16.7 ms, got 17.3 ms at 1000000 baud" in line
    assert "16 ms the adapter's latency" in line
    assert "within 1 ms, or a control_rate_hz of 34 at most in the head file" in line


def test_answers_that_begin_to_come_late_are_told_from_a_bad_cable(robot):
    robot.begin()
    robot.plant.step(STILL)
    robot.fault(what="late", ids=[2], value=0.012)
    for _ in range(20):
        robot.plant.step(STILL)
        if robot.plant.fault:
            break
    assert "left_tilt: expected an answer of the id 2 on" in robot.plant.fault
    assert "within 6 ms, got later ones alone for 0.1 s; cure: another adapter" in robot.plant.fault


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
