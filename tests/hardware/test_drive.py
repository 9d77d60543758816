"""The drive on a robot in simulated time: its history, its beginning, its rests and its lines."""

import logging
import time
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.faults import Mover
from tests.hardware.fakes import HEAD
from tests.hardware.virtual import LIMIT_RAD, VirtualRobot
from vergence.errors import HardwareError
from vergence.hardware.drive import JointHistory
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.checks import cycle_timeout_s
from vergence.hardware.emulator.config import EmulatorConfig
from vergence.hardware.emulator.world import World
from vergence.hardware.safety.limits import ForbiddenPosture

SPEED = np.array([0.5, 0.0, -1.0, 2.0, 0.0, 0.25, -3.0])


def history_of(times):
    """A history of joints that all turn at constant speeds from zero at time zero."""
    history = JointHistory()
    for time_s in times:
        history.add(time_s, SPEED * time_s, SPEED)
    return history


@given(st.lists(st.floats(0.001, 0.5), min_size=2, max_size=20), st.floats(0.0, 1.0))
def test_joints_at_constant_speeds_are_known_exactly_at_any_time(steps, share):
    times = np.cumsum(steps)
    asked_s = times[0] + share * (times[-1] - times[0])
    assert history_of(times).at(asked_s) == pytest.approx(SPEED * asked_s, abs=1e-12)


def test_joints_rested_before_the_readings_and_go_on_after_them_for_a_twentieth_of_a_second():
    history = history_of([1.0, 2.0])
    assert history.at(0.25) == pytest.approx(SPEED)
    assert history.at(2.03) == pytest.approx(SPEED * 2.03)
    assert history.at(7.0) == pytest.approx(SPEED * 2.05)


def test_no_reading_is_no_angle():
    for ask in (lambda: JointHistory().at(0.0), lambda: JointHistory().newest()):
        with pytest.raises(LookupError, match="no reading"):
            ask()


def test_a_reading_is_kept_as_it_was():
    history, angles = JointHistory(), np.ones(7)
    history.add(0.0, angles, np.zeros(7))
    angles[:] = 5.0
    history.at(0.0)[:] = 6.0
    assert (history.at(0.0) == 1.0).all()
    time_s, positions, velocities = history.newest()
    assert (time_s, positions.tolist(), velocities.tolist()) == (0.0, [1.0] * 7, [0.0] * 7)


def test_seconds_of_readings_are_kept_and_no_more():
    history = history_of(np.arange(1000) / 120.0)
    assert history.at(999 / 120.0 - 4.0) == pytest.approx(SPEED * (999 / 120.0 - 4.0))
    assert history.at(0.0)[0] > 1.0  # long ago: the oldest that is kept


FAST = np.full((1, 7), 2.0)


@pytest.fixture
def running(monkeypatch):
    one = VirtualRobot(monkeypatch)
    one.begin()
    for _ in range(20):
        one.plant.step(FAST)
    return one


def goals(robot):
    return robot.registers(table.GOAL_VELOCITY)


def test_a_command_is_repeated_for_two_periods_more_and_then_the_joints_are_braked(running):
    turning = goals(running)
    period_s = running.plant.head.timing.period_s
    running.clock.sleep(1.9 * period_s)
    assert np.abs(np.subtract(goals(running), turning)).max() <= 1  # carried over
    running.clock.sleep(4.0 * period_s)
    assert goals(running) == [0] * 4


def test_a_policy_that_comes_back_in_time_goes_on_a_period_after_what_was_said_for_it(running):
    drive, period_s = running.plant.robot.drive, running.plant.head.timing.period_s
    running.clock.sleep(period_s)
    repeated_s = drive._repeated_s
    running.plant.step(FAST)
    assert running.plant.fault == ""
    assert drive._requested_s == pytest.approx(repeated_s + period_s)


@pytest.mark.parametrize("error", [HardwareError("nobody answers"), RuntimeError("a mistake")])
def test_what_goes_wrong_meanwhile_stops_the_head_and_not_the_thread(running, monkeypatch, error):
    with monkeypatch.context() as broken:
        broken.setattr(running.plant.robot.drive._servos, "read", Mock(side_effect=error))
        running.clock.sleep(0.2)
    assert running.plant.fault == str(error)
    assert goals(running) == [0] * 4
    running.plant.step(FAST)  # says so once
    with pytest.raises(HardwareError, match="release it first"):
        running.plant.step(FAST)


def test_the_thread_ends_with_the_drive(running):
    drive = running.plant.robot.drive
    super(type(drive), drive).start()  # in real time: it has nothing to say, as all is at rest
    running.plant.step(0.0 * FAST)
    running.plant.close()
    time.sleep(0.01)
    assert not drive.is_alive()


@pytest.mark.slow
def test_a_process_that_stands_still_leads_no_joint_beyond_its_limit(monkeypatch):
    for steps in (4, 25):
        robot = VirtualRobot(monkeypatch)
        robot.begin()
        for _ in range(steps):
            robot.plant.step(np.full((1, 7), np.inf))
        robot.clock.stand_still(1.0)
        robot.world.advance_to(robot.clock())
        assert 0.3 < max(one.q for one in robot.world.servos.values()) < LIMIT_RAD, steps


@pytest.mark.slow
@pytest.mark.parametrize("what", ["lost", "silent", "unplug", "stuck"])
def test_a_fault_of_the_line_leads_no_joint_beyond_its_limit(monkeypatch, what):
    robot = VirtualRobot(monkeypatch)
    robot.begin()
    fast = np.full((1, 7), np.inf)
    for _ in range(20):
        robot.plant.step(fast)
    robot.fault(what=what) if what in ("lost", "unplug") else robot.fault(what=what, ids=[1])
    while not robot.plant.fault:
        robot.plant.step(fast)
    robot.clock.sleep(0.5)
    robot.world.advance_to(robot.clock())
    assert max(one.q for one in robot.world.servos.values()) < LIMIT_RAD


def test_who_has_not_begun_a_trial_may_not_step(monkeypatch):
    robot = VirtualRobot(monkeypatch)
    robot.begin()
    interrupt = Mock(side_effect=KeyboardInterrupt)
    monkeypatch.setattr(robot.plant.robot.drive._servos, "switch_on", interrupt)
    with pytest.raises(KeyboardInterrupt):
        robot.begin()
    with pytest.raises(HardwareError, match="expected a reset first"):
        robot.plant.step(FAST)


def test_a_child_process_leaves_the_servos_to_its_parent(running, monkeypatch):
    watchdogs = running.registers(table.BUS_WATCHDOG)
    drive = running.plant.robot.drive
    with monkeypatch.context() as child:
        child.setattr(drive, "_pid", -1)
        with pytest.raises(HardwareError, match="expected a reset first"):
            drive.send(FAST[0])
        running.plant.close()
    assert running.registers(table.BUS_WATCHDOG) == watchdogs


def test_a_servo_that_does_not_confirm_to_be_at_rest_keeps_its_watchdog(running):
    running.fault(what="lost", ids=[2])
    running.plant.robot.close()
    assert [watchdog > 0 for watchdog in running.registers(table.BUS_WATCHDOG)] == [0, 1, 0, 0]


@pytest.mark.slow
def test_a_command_that_is_held_back_is_not_repeated_either(monkeypatch):
    robot = VirtualRobot(monkeypatch, search=True, overruns=1.0)
    robot.begin()
    monkeypatch.setattr(robot.eyes[0], "take_searched_images", list)
    monkeypatch.setattr(robot.eyes[1], "take_searched_images", list)
    robot.plant.reading.visible[:] = False
    fastest = []
    for _ in range(60):
        robot.plant.step(3.0 * FAST)
        robot.clock.sleep(0.03)
        fastest.append(np.abs(goals(robot)).max() * table.TICK_RAD_S)
    # the policy drives until the target counts as lost; then the spiral of the search does
    assert max(fastest[:10]) > 2.0
    assert 0.0 < max(fastest[30:]) < 1.0


@pytest.fixture
def barred(monkeypatch):
    """A robot with a posture of its left pan that is forbidden."""
    bar = ForbiddenPosture(name="the bar", slots=(3,), lower=np.array([0.5]), upper=np.array([0.7]))
    return VirtualRobot(monkeypatch, forbidden=(bar,))


def test_a_start_in_a_forbidden_posture_is_refused_before_anything_moves(barred):
    with pytest.raises(HardwareError, match=r"start: .* 'the bar', got left_pan 0\.600 rad"):
        barred.begin(left_pan_rad=0.6)
    assert [one.q for one in barred.world.servos.values()] == [0.0] * 4


@pytest.mark.slow
def test_a_start_behind_a_forbidden_posture_names_what_is_in_the_way(barred):
    begun_s = barred.clock()
    with pytest.raises(HardwareError, match=r"left_pan: .* 'the bar' is in the way"):
        barred.begin(left_pan_rad=1.0)
    assert barred.clock() - begun_s < 6.0
    assert barred.world.servos["left_pan"].q < 0.5


def test_a_joint_at_its_middle_is_proved_before_it_is_driven_fast(barred):
    barred.begin()
    assert barred.plant.robot.supervisor.proved_joints[3:].all()


def test_an_overload_before_the_start_names_the_joint_and_what_to_do(barred):
    barred.plant.prepare()
    barred.fault(what="overload", ids=[2])
    with pytest.raises(HardwareError, match=r"left_tilt: .* overload: .*; cure: hold the head"):
        barred.begin()


@pytest.mark.slow
def test_beginning_anew_brakes_a_moving_head_first(monkeypatch):
    robot = VirtualRobot(monkeypatch, acceleration_rad_s2=20.0)
    robot.begin()
    fast = np.full((1, 7), -np.inf)
    for _ in range(12):
        robot.plant.step(fast)
    moved, speeds, sleep = robot.world.servos["right_pan"], [], robot.clock.sleep
    robot.plant.robot.drive._sleep = lambda seconds: (
        speeds.append(moved.get(table.GOAL_VELOCITY)) or sleep(seconds)
    )
    robot.begin()
    # to rest in more than one command
    assert speeds[0] < speeds[1] < 0, speeds[:8]


BOUND_S, TRAVEL_RAD = 0.5, 0.5


@pytest.fixture
def frictional(monkeypatch):
    world = World(HEAD, np.array([0.0, -0.1, 1.0]), EmulatorConfig(friction=0.03))
    return VirtualRobot(monkeypatch, world)


def drive(robot, mover, seconds):
    until_s = robot.clock() + seconds
    while robot.clock() < until_s and not robot.plant.fault:
        robot.plant.step(mover.command(robot.clock()))


def left_pan(robot):
    return robot.world.servos["left_pan"]


def travel_rad(robot, since_s):
    trace = left_pan(robot).trace.samples_since(since_s)
    return max(abs(sample.position_rad - trace[0].position_rad) for sample in trace)


@pytest.mark.slow
@pytest.mark.parametrize(("what", "seed"), [("blind", 0), ("blind-told", 1), ("inverted", 1)])
def test_a_servo_that_zero_does_not_stop_loses_its_torque(frictional, what, seed):
    frictional.begin()
    left_pan(frictional).set(table.SHUTDOWN, 52)  # from the factory: without the encoder
    mover = Mover(np.random.default_rng(seed))
    drive(frictional, mover, 0.4 + 0.3 * seed)
    since_s = frictional.clock()
    frictional.fault(what=what, ids=[1])
    drive(frictional, mover, 3.0)
    assert "left_pan without torque" in frictional.plant.fault
    assert frictional.registers(table.TORQUE_ENABLE) == [0, 1, 1, 1]
    frictional.clock.sleep(1.0)
    assert frictional.rested_s(since_s) < BOUND_S
    assert travel_rad(frictional, since_s) < TRAVEL_RAD


@pytest.mark.slow
@pytest.mark.parametrize("what", ["blind", "inverted"])
def test_the_motion_that_proves_joints_finds_a_servo_that_zero_does_not_stop(frictional, what):
    frictional.plant.prepare()
    frictional.fault(what=what, ids=[1])
    since_s = frictional.clock()
    with pytest.raises(HardwareError, match="left_pan"):
        frictional.begin()
    assert left_pan(frictional).get(table.TORQUE_ENABLE) == 0
    assert travel_rad(frictional, since_s) < TRAVEL_RAD


@pytest.mark.slow
def test_closing_reads_rest_before_it_ends(frictional):
    frictional.begin()
    drive(frictional, Mover(np.random.default_rng(1)), 0.6)
    left_pan(frictional).inverted = True
    frictional.plant.close()
    assert left_pan(frictional).get(table.TORQUE_ENABLE) == 0
    frictional.clock.sleep(0.5)
    frictional.world.advance_to(frictional.clock())
    assert abs(left_pan(frictional).v) < table.TICK_RAD_S


@pytest.mark.slow
def test_a_pause_of_this_process_comes_first_in_the_reason(frictional):
    frictional.begin()
    drive(frictional, Mover(np.random.default_rng(2)), 0.5)
    frictional.clock.stand_still(1.0)
    drive(frictional, Mover(np.random.default_rng(2)), 0.2)
    assert frictional.plant.fault.startswith("bus: expected the servos to hear something")
    assert "without torque" not in frictional.plant.fault


@pytest.mark.slow
def test_a_fault_of_a_camera_after_a_pause_names_the_pause_first(frictional):
    frictional.begin()
    drive(frictional, Mover(np.random.default_rng(2)), 0.5)
    frictional.clock.now += 0.15  # the watchdog holds
    frictional.eyes[0].ended_s = frictional.clock()
    drive(frictional, Mover(np.random.default_rng(2)), 0.2)
    assert "nothing was sent for 0.1" in frictional.plant.fault.partition("after that")[0]
    assert "cameras.left" in frictional.plant.fault.partition("after that")[2]


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


SLOT = 3


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
