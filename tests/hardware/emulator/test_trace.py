"""The traces of joints say from when on all are at rest."""

from math import log

import pytest

from tests.hardware.emulator.questions import read, turning, write
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.emulator.servo import REST_RAD_S, rest_start_and_top_speed


def stopping():
    """A joint that turns at 1.2 rad/s and is told to stop at 1 s."""
    line = turning(goal=50, lag_s=0.03, acceleration=1e9, lower=-9.0, upper=9.0)
    line.advance_to(1.0)
    write(line, 1.0, 1, table.GOAL_VELOCITY, 0)
    return line


def rest(line, since_s):
    return rest_start_and_top_speed([servo.trace for servo in line.servos], since_s)


def test_rest_begins_when_the_speed_falls_below_a_step():
    line = stopping()
    line.advance_to(5.0)
    for since_s in (0.5, 1.0):
        rested_s, fastest = rest(line, since_s)
        assert rested_s == pytest.approx(1.0 + 0.03 * log(50), abs=1e-4)
        assert fastest == pytest.approx(50 * REST_RAD_S)
    # what rests already rests since then
    assert rest(line, 3.0) == (3.0, pytest.approx(0.0, abs=1e-9))


def test_rest_does_not_depend_on_how_often_the_joint_was_looked_at():
    often, once = stopping(), stopping()
    for i in range(100):
        read(often, 1.0 + 0.0007 * i, 1, table.PRESENT_VELOCITY)
    for line in (often, once):
        line.advance_to(2.0)
    assert rest(often, 1.0)[0] == pytest.approx(rest(once, 1.0)[0], abs=1e-4)


def test_a_trace_of_steady_motion_stays_short():
    line = turning(lower=-1e9, upper=1e9)
    for i in range(1000):
        line.advance_to(60.0 + 0.01 * i)
    moments = line.servos[0].trace.samples_since(69.0)
    assert len(moments) < 10
    assert [moment.time_s for moment in (moments[0], moments[-1])] == pytest.approx([69.0, 69.99])
