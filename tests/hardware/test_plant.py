"""The plant of a real head: on a pseudo-terminal and threads of cameras, and in simulated time."""

import dataclasses
import gc
import re

import numpy as np
import pytest

from tests.hardware.desk import desk_config
from tests.hardware.fakes import HEAD, LiveCapture, blank
from tests.hardware.line import make_servo
from vergence import load_head
from vergence.errors import ChecksFailedError, ConfigurationError, Finding, HardwareError
from vergence.hardware import cameras
from vergence.hardware import robot as robot_module
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.plant import HardwarePlant

PLACES = np.zeros(1, dtype=np.int64)
STILL = np.zeros((1, 7))
FAST = np.array([[0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0]])


@pytest.mark.slow
@pytest.mark.real_time
@pytest.mark.flaky(reruns=3, reruns_delay=15)
def test_a_camera_that_ends_ends_the_trial_and_a_line_that_is_gone_still_closes(serve, monkeypatch):
    captures = []

    def open_capture(*_words, **_options):
        captures.append(LiveCapture(blank(HEAD), HEAD.timing.frame_rate_hz))
        return captures[-1]

    monkeypatch.setattr(cameras, "open_capture", open_capture)
    monkeypatch.setattr(robot_module, "check_local_cameras", lambda _config: [])
    served = serve([make_servo(ident, lower=-3.2, upper=3.2) for ident in range(1, 5)])
    config = desk_config(served.port)
    # a watchdog that no busy machine lets trip
    config = dataclasses.replace(config, bus=dataclasses.replace(config.bus, watchdog_s=2.0))
    plant = HardwarePlant(HEAD, config=config, view_check=False)
    plant.reset(PLACES, HEAD.rest()[None])
    captures[1].end()
    plant.robot.eyes.threads[1].join()
    plant.step(STILL)
    assert "cameras.right: 8: the stream ended" in plant.fault
    served.hang_up()
    plant.close()
    assert [capture.released for capture in captures] == [1, 1]


def test_another_head_or_more_than_one_is_refused_before_anything_is_opened(robot):
    with pytest.raises(ConfigurationError, match="num: expected 1"):
        HardwarePlant(HEAD, 2, config=robot.config)
    with pytest.raises(ConfigurationError, match="head: expected the head of robot"):
        HardwarePlant(load_head("physical"), config=robot.config)
    assert not hasattr(robot, "eyes")


def test_nothing_has_torque_before_reset_and_preparing_twice_opens_once(robot):
    robot.plant.prepare()
    opened = robot.eyes
    robot.plant.prepare()
    assert robot.eyes is opened
    assert robot.registers(table.TORQUE_ENABLE) == [0] * 4


@pytest.mark.slow
def test_a_trial_begins_at_rest_at_its_start_and_time_is_the_schedules(robot):
    for servo in robot.world.servos.values():
        servo.q = 0.1
    robot.begin()
    reading = robot.plant.reading
    assert reading.time_s[0] == 0.0
    assert (reading.frame[0], reading.command.any()) == (0, False)
    assert np.abs(robot.world.line.positions()).max() < 0.012
    told = np.array([[9.0, 9.0, 9.0, 0.5, -0.5, 50.0, 0.011]])
    for period in range(1, 9):
        reading = robot.plant.step(told)
        # nothing moves that has no servo, and what is said to be sent is what was sent
        assert (reading.command[0, :3] == 0.0).all()
        goals = np.array(robot.registers(table.GOAL_VELOCITY))
        assert reading.command[0, 3:] == pytest.approx(goals * table.TICK_RAD_S)
        assert reading.time_s[0] == pytest.approx(period * HEAD.timing.period_s, abs=1e-9)
    assert reading.positions[0, 3] > 0.02 > -0.02 > reading.positions[0, 4]


def test_what_is_wrong_with_cameras_and_servos_is_told_at_once(robot, monkeypatch):
    robot.world.servos["right_pan"].set(table.HOMING_OFFSET, 5)
    dark = Finding(part="cameras.left", problem="expected images, got none")
    monkeypatch.setattr(robot_module, "check_local_cameras", lambda _config: [dark])
    with pytest.raises(ChecksFailedError) as failed:
        robot.plant.prepare()
    assert [one.part for one in failed.value.findings] == ["servos: right_pan", "cameras.left"]
    assert not hasattr(robot, "eyes")
    assert robot.registers(table.TORQUE_ENABLE) == [0] * 4


def test_a_closed_head_takes_no_command_and_closes_twice(robot):
    with pytest.raises(HardwareError, match="expected a reset first"):
        robot.plant.step(STILL)
    robot.plant.close()
    robot.plant.close()


def test_a_command_of_another_shape_is_refused(robot):
    robot.begin()
    with pytest.raises(ConfigurationError, match=r"expected shape \(1, 7\), got \(1, 6\)"):
        robot.plant.step([[0.0] * 6])


def test_a_watchdog_that_trips_ends_a_trial_but_not_the_wait_before_it(robot):
    robot.begin()
    robot.clock.stand_still(1.0)
    robot.plant.step(STILL)
    assert robot.plant.fault == ""
    robot.clock.stand_still(1.0)
    robot.plant.step(STILL)
    assert re.search(r"hear something every 0\.22 s, got", robot.plant.fault)
    robot.plant.close()
    assert robot.registers(table.BUS_WATCHDOG) == [0] * 4


@pytest.mark.slow
def test_a_stop_brakes_before_step_returns_and_latches_until_released(robot):
    robot.begin()
    for _ in range(6):
        robot.plant.step(FAST)
    assert np.abs(robot.world.line.velocities()).max() > 0.4
    robot.plant.step(np.full((1, 7), np.nan))
    assert "got nan" in robot.plant.fault
    assert robot.registers(table.GOAL_VELOCITY) == [0] * 4
    assert robot.registers(table.TORQUE_ENABLE) == [1] * 4
    for call in (lambda: robot.plant.step(STILL), robot.begin, robot.plant.prepare):
        with pytest.raises(HardwareError, match="release it first"):
            call()
    robot.plant.release()
    assert robot.plant.fault == ""
    robot.begin()
    robot.plant.step(STILL)
    assert robot.plant.fault == ""
    robot.plant.close()
    assert robot.registers(table.BUS_WATCHDOG) == [0] * 4


def test_an_answer_that_misses_is_counted_and_ends_nothing(robot):
    robot.begin()
    robot.plant.step(STILL)
    before = robot.plant.diagnostics()["missed_answers"]
    robot.fault(what="silent", ids=[3])
    reading = robot.plant.step(STILL)
    assert np.isfinite(reading.positions).all()
    assert robot.plant.diagnostics()["missed_answers"] > before
    assert robot.plant.fault == ""


def test_one_answer_that_misses_after_a_long_wait_is_no_silence(robot):
    robot.begin()
    robot.clock.stand_still(30.0)
    robot.fault(what="silent", ids=[1])
    robot.plant.robot.drive.sense()
    assert np.isfinite(robot.plant.robot.history.newest().positions).all()


def test_a_missed_period_is_skipped_on_the_grid(robot):
    robot.begin()
    drive, clock = robot.plant.robot.drive, robot.clock
    robot.plant.step(STILL)
    assert (drive.tick, robot.plant.overruns) == (1, 0)
    clock.stand_still(3.5 * HEAD.timing.period_s)
    robot.plant.step(STILL)
    # period 2 was due long ago, and so were 3 and 4
    assert (drive.tick, robot.plant.overruns) == (4, 2)
    reading = robot.plant.step(STILL)
    assert reading.time_s[0] == pytest.approx(5 * HEAD.timing.period_s)


def test_a_plant_that_nobody_holds_any_more_is_closed(robot):
    robot.begin()
    robot.plant.step(FAST)
    assert min(robot.registers(table.GOAL_VELOCITY)) > 0
    del robot.plant
    gc.collect()
    assert robot.registers(table.GOAL_VELOCITY) == [0] * 4
