"""The drive on a robot in simulated time: its history, its beginning, its rests and its lines."""

import logging
import os
import threading
import time
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.faults import Mover
from tests.hardware.fakes import HEAD
from tests.hardware.virtual import LIMIT_RAD, VirtualRobot
from tests.naming import refused
from vergence.errors import HardwareError
from vergence.hardware.drive import JointHistory
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.checks import cycle_timeout_s
from vergence.hardware.dynamixel.packets import ErrorNumber
from vergence.hardware.dynamixel.servos import DynamixelServos
from vergence.hardware.emulator.config import EmulatorConfig
from vergence.hardware.emulator.world import World
from vergence.hardware.safety.limits import ForbiddenPosture

PERIOD_S = HEAD.timing.period_s
LEFT_PAN = np.eye(7)[3]
SPEED = np.array([0.5, 0.0, -1.0, 2.0, 0.0, 0.25, -3.0])


def left_pan(robot):
    return robot.world.servos["left_pan"]


def goals(robot):
    return robot.registers(table.GOAL_VELOCITY)


def greatest_angle_rad(robot):
    robot.world.advance_to(robot.clock())
    return max(one.q for one in robot.world.servos.values())


def emulated(monkeypatch, **options):
    world = World(HEAD, np.array([0.0, -0.1, 1.0]), EmulatorConfig(**options))
    return VirtualRobot(monkeypatch, world)


# ---- the joints by time ----


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
    for asked_s, known_s in ((0.25, 1.0), (2.03, 2.03), (7.0, 2.05)):
        assert history.at(asked_s) == pytest.approx(SPEED * known_s)


def test_no_reading_is_no_angle():
    for ask in (lambda: JointHistory().at(0.0), lambda: JointHistory().newest()):
        refused("no reading", ask, error=LookupError)


def test_a_reading_is_kept_as_it_was():
    history, angles = JointHistory(), np.ones(7)
    history.add(0.0, angles, np.zeros(7))
    angles[:] = 5.0
    history.at(0.0)[:] = 6.0
    assert (history.at(0.0) == 1.0).all()


def test_seconds_of_readings_are_kept_and_no_more():
    history = history_of(np.arange(1000) / 120.0)
    assert history.at(999 / 120.0 - 4.0) == pytest.approx(SPEED * (999 / 120.0 - 4.0))
    assert history.at(0.0)[0] > 1.0  # long ago: the oldest that is kept


# ---- who speaks to the servos, and when ----


@pytest.fixture
def running(robot):
    robot.begin()
    robot.step(2.0, count=20)
    return robot


def test_a_command_is_repeated_for_two_periods_more_and_then_the_joints_are_braked(running):
    turning = goals(running)
    running.clock.sleep(1.9 * PERIOD_S)
    assert np.abs(np.subtract(goals(running), turning)).max() <= 1  # carried over
    running.clock.sleep(4.0 * PERIOD_S)
    assert goals(running) == [0] * 4


def test_a_policy_that_comes_back_in_time_goes_on_a_period_after_what_was_said_for_it(monkeypatch):
    robot = VirtualRobot(monkeypatch, plant_options={"log": (log := Mock())})
    robot.begin()
    robot.step(2.0, count=5)
    robot.clock.sleep(PERIOD_S)
    robot.step(2.0)
    repeated, own = (call.args[0] for call in log.command.call_args_list[-2:])
    assert robot.plant.fault == ""
    assert (repeated.by, own.by) == ("robot", "policy")
    assert own.clock_s - repeated.clock_s == pytest.approx(PERIOD_S, abs=2e-3)


@pytest.mark.parametrize("error", [HardwareError("nobody answers"), RuntimeError("a mistake")])
def test_what_goes_wrong_meanwhile_stops_the_head_and_not_the_thread(running, monkeypatch, error):
    with monkeypatch.context() as broken:
        broken.setattr(DynamixelServos, "read", Mock(side_effect=error))
        running.clock.sleep(0.2)
    assert running.plant.fault == str(error)
    assert goals(running) == [0] * 4
    running.step(2.0)  # says so once
    refused("release it first", running.step, 2.0, error=HardwareError)


def test_the_thread_ends_with_the_drive(running):
    drive = running.plant.robot.drive
    super(type(drive), drive).start()  # in real time: it has nothing to say, as all is at rest
    running.step(0.0)
    running.plant.close()
    time.sleep(0.01)
    assert not drive.is_alive()


@pytest.mark.slow
@pytest.mark.parametrize("steps", [4, 25])
def test_a_process_that_stands_still_leads_no_joint_beyond_its_limit(robot, steps):
    robot.begin()
    robot.step(np.inf, count=steps)
    robot.clock.stand_still(1.0)
    assert 0.3 < greatest_angle_rad(robot) < LIMIT_RAD


@pytest.mark.slow
@pytest.mark.parametrize("fault", [
    {"what": "lost"}, {"what": "unplug"}, {"what": "silent", "ids": [1]},
    {"what": "stuck", "ids": [1]},
])  # fmt: skip
def test_a_fault_of_the_line_leads_no_joint_beyond_its_limit(robot, fault):
    robot.begin()
    robot.step(np.inf, count=20)
    robot.fault(**fault)
    robot.follow(lambda _now_s: np.full((1, 7), np.inf), 2.0)
    assert robot.plant.fault
    robot.clock.sleep(0.5)
    assert greatest_angle_rad(robot) < LIMIT_RAD


def test_who_has_not_begun_a_trial_may_not_step(running, monkeypatch):
    monkeypatch.setattr(DynamixelServos, "switch_on", Mock(side_effect=KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        running.begin()
    refused("expected a reset first", running.step, 2.0, error=HardwareError)


def test_a_child_process_leaves_the_servos_to_its_parent(running, monkeypatch):
    watchdogs, drive = running.registers(table.BUS_WATCHDOG), running.plant.robot.drive
    with monkeypatch.context() as child:
        child.setattr(os, "getpid", lambda: -1)
        refused("expected a reset first", drive.send, LEFT_PAN, error=HardwareError)
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
    for eye in robot.eyes:
        monkeypatch.setattr(eye, "take_searched_images", list)
    robot.plant.reading.visible[:] = False
    fastest = []
    for _ in range(60):
        robot.step(6.0)
        robot.clock.sleep(0.03)
        fastest.append(np.abs(goals(robot)).max() * table.TICK_RAD_S)
    # the policy drives until the target counts as lost; then the spiral of the search does
    assert max(fastest[:10]) > 2.0
    assert 0.0 < max(fastest[30:]) < 1.0


# ---- the way to where a trial begins ----


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
    assert left_pan(barred).q < 0.5


def test_a_joint_at_its_middle_is_proved_before_it_is_driven_fast(robot):
    robot.begin()
    assert robot.plant.robot.supervisor.proved_joints[3:].all()


def test_an_overload_before_the_start_names_the_joint_and_what_to_do(robot):
    robot.plant.prepare()
    robot.fault(what="overload", ids=[2])
    refused(r"left_tilt: .* overload: .*; cure: hold the head", robot.begin, error=HardwareError)


@pytest.mark.slow
def test_beginning_anew_brakes_a_moving_head_first(monkeypatch):
    robot = VirtualRobot(monkeypatch, acceleration_rad_s2=20.0)
    robot.begin()
    robot.step(-np.inf, count=12)
    moved = robot.world.servos["right_pan"]
    write = Mock(side_effect=moved.write)
    monkeypatch.setattr(moved, "write", write)
    robot.begin()
    goal = table.GOAL_VELOCITY
    speeds = [
        goal.decode(call.args[1]) for call in write.call_args_list if call.args[0] == goal.address
    ]
    # to rest in more than one command
    assert speeds[0] < speeds[1] < 0, speeds[:8]


@pytest.mark.parametrize("appears", [False, True])
def test_a_target_that_appears_is_not_seen_in_images_of_before(monkeypatch, appears):
    robot = VirtualRobot(monkeypatch, plant_options={"appears": appears})
    robot.begin()
    reading = robot.plant.reading
    assert reading.visible.any() == (not appears)
    while not reading.visible.any() or reading.exposure_s[0] < 0.0:
        reading = robot.step(0.0)
        assert reading.time_s[0] < 0.5
    assert reading.time_s[0] > HEAD.timing.latency_s - PERIOD_S


# ---- joints that a goal of zero does not stop: half a second and half a turn ----

BOUND_S, TRAVEL_RAD = 0.5, 0.5


@pytest.fixture
def frictional(monkeypatch):
    return emulated(monkeypatch, friction=0.03)


def mover(seed):
    return Mover(np.random.default_rng(seed)).command


def travel_rad(robot, since_s):
    trace = left_pan(robot).trace.samples_since(since_s)
    return max(abs(sample.position_rad - trace[0].position_rad) for sample in trace)


@pytest.mark.slow
@pytest.mark.parametrize(("what", "seed"), [("blind", 0), ("blind-told", 1), ("inverted", 1)])
def test_a_servo_that_zero_does_not_stop_loses_its_torque(frictional, what, seed):
    frictional.begin()
    left_pan(frictional).set(table.SHUTDOWN, 52)  # from the factory: without the encoder
    command = mover(seed)
    frictional.follow(command, 0.4 + 0.3 * seed)
    since_s = frictional.clock()
    frictional.fault(what=what, ids=[1])
    frictional.follow(command, 3.0)
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
    refused("left_pan", frictional.begin, error=HardwareError)
    assert left_pan(frictional).get(table.TORQUE_ENABLE) == 0
    assert travel_rad(frictional, since_s) < TRAVEL_RAD


@pytest.mark.slow
def test_closing_reads_rest_before_it_ends(frictional):
    frictional.begin()
    frictional.follow(mover(1), 0.6)
    left_pan(frictional).inverted = True
    frictional.plant.close()
    assert left_pan(frictional).get(table.TORQUE_ENABLE) == 0
    frictional.clock.sleep(0.5)
    frictional.world.advance_to(frictional.clock())
    assert abs(left_pan(frictional).v) < table.TICK_RAD_S


@pytest.mark.slow
@pytest.mark.parametrize("camera_ends", [False, True])
def test_a_pause_of_this_process_comes_first_in_the_reason(frictional, camera_ends):
    frictional.begin()
    frictional.follow(mover(2), 0.5)
    frictional.clock.stand_still(0.15 if camera_ends else 1.0)  # the watchdog holds, or trips
    if camera_ends:
        frictional.eyes[0].ended_s = frictional.clock()
    frictional.follow(mover(2), 0.2)
    first, _, then = frictional.plant.fault.partition("after that")
    assert ("nothing was sent for 0.1" if camera_ends else "bus: expected the servos to h") in first
    assert ("cameras.left" in then) == camera_ends
    assert "without torque" not in frictional.plant.fault


# ---- an adapter that holds answers back ----


@pytest.mark.slow
def test_answers_that_come_within_the_period_are_waited_for(monkeypatch):
    robot = emulated(monkeypatch, answer_latency_s=0.008)
    robot.begin()
    robot.step(0.0, count=60)
    assert robot.plant.fault == ""
    assert robot.plant.diagnostics()["missed_answers"] == 0


@pytest.mark.parametrize("latency_s", [0.0, 0.006])
def test_a_reading_is_dated_at_its_request(monkeypatch, latency_s):
    robot = emulated(monkeypatch, answer_latency_s=latency_s)
    robot.begin()
    reading = robot.step(LEFT_PAN, count=20)
    told_s = reading.joints_s[0] + robot.plant.begun_s
    trace = left_pan(robot).trace.samples_since(told_s)
    # half a tick, and what it turns within the request's 0.2 ms
    assert reading.positions[0, 3] == pytest.approx(trace[0].position_rad, abs=1.2e-3)


def test_a_timeout_leaves_time_in_the_period():
    for latency_s, timeout_s in ((0.0, 0.006), (0.008, 0.012), (0.016, 0.75 / 60)):
        assert cycle_timeout_s(latency_s, 1 / 60) == pytest.approx(timeout_s)


# ---- a robot outside a trial ----


@pytest.mark.slow
def test_joints_are_exercised_within_the_bounds_and_rest_afterwards(robot):
    robot.begin()
    robot.plant.robot.exercise([0.15 * LEFT_PAN] * 60)
    assert left_pan(robot).q == pytest.approx(0.15, abs=0.02)
    robot.plant.robot.exercise([50.0 * LEFT_PAN] * 60)  # towards the limit, which is not reached
    now = robot.clock()
    robot.clock.sleep(0.5)
    assert robot.rested_s(now) < 0.3
    assert 1.0 < left_pan(robot).q <= LIMIT_RAD


def test_what_stops_a_robot_that_is_exercised_stays_its_fault(robot):
    robot.begin()

    def until_the_cable_is_pulled():
        yield from [0.15 * LEFT_PAN] * 10
        robot.fault(what="unplug")
        yield from [0.15 * LEFT_PAN] * 10

    with pytest.raises(HardwareError, match="the serial line is gone"):
        robot.plant.robot.exercise(until_the_cable_is_pulled())
    assert "the serial line is gone" in robot.plant.fault


# ---- lines of the log: a few a trial, none a period, one for each stop ----


@pytest.fixture
def logged(robot, caplog):
    caplog.set_level(logging.DEBUG, "vergence")
    robot.begin()
    robot.step(0.0)
    caplog.clear()
    return robot


@pytest.mark.slow
def test_a_period_says_nothing(logged, caplog):
    logged.step(0.0, count=70)  # more than a second
    assert caplog.records == []


@pytest.mark.slow
def test_missed_periods_are_told_once_a_second(logged, caplog):
    begun_s = logged.clock()
    while logged.clock() < begun_s + 1.5:
        logged.step(0.0, count=8)
        logged.clock.stand_still(2.2 * PERIOD_S)
    assert logged.plant.overruns > 2
    assert sum(one.message.startswith("periods missed") for one in caplog.records) == 2


def test_a_stop_is_an_error_with_its_reason(logged, caplog):
    logged.fault(what="unplug")
    logged.step(0.0)
    (error,) = [one for one in caplog.records if one.levelno == logging.ERROR]
    assert logged.plant.fault
    assert error.getMessage() == f"stopped: {logged.plant.fault}"


SLOW = np.array([[0.0, 0.0, 0.0, 0.6, 0.3, 0.2, 0.2]])


def lost_torque(robot):
    return [torque == 0 for torque in robot.registers(table.TORQUE_ENABLE)]


@pytest.fixture
def turning(robot):
    robot.begin()
    for _ in range(25):
        robot.plant.step(SLOW)
    return robot


def test_a_joint_that_turns_on_at_a_reset_does_not_get_its_torque_back(turning):
    turning.fault(what="inverted", ids=[1])
    with pytest.raises(HardwareError, match="left_pan: expected rest at a velocity of zero"):
        turning.begin()
    assert lost_torque(turning) == [True, False, False, False]
    turning.plant.close()
    assert lost_torque(turning) == [True, False, False, False]


def test_a_release_that_no_servo_confirms_is_tried_again(turning, monkeypatch):
    servo, lost = turning.world.servos["left_pan"], []
    write = servo.write

    def refuses(address, data):
        if (address, data) == (table.TORQUE_ENABLE.address, b"\0") and len(lost) < 4:
            lost.append(data)
            return ErrorNumber.RESULT_FAIL
        return write(address, data)

    monkeypatch.setattr(servo, "write", refuses)
    turning.fault(what="inverted", ids=[1])
    turning.plant.rest("somebody asked")
    assert "left_pan without torque" not in turning.plant.fault
    turning.plant.close()
    assert lost_torque(turning) == [True, False, False, False]


def test_servos_that_were_being_armed_are_left_without_a_watchdog(robot, monkeypatch):
    servo = robot.world.servos["right_tilt"]
    write = servo.write

    def interrupts(address, data):
        if address == table.BUS_WATCHDOG.address and data != b"\0":
            raise KeyboardInterrupt
        return write(address, data)

    monkeypatch.setattr(servo, "write", interrupts)
    with pytest.raises(KeyboardInterrupt):
        robot.begin()
    monkeypatch.undo()
    robot.plant.close()
    assert robot.registers(table.BUS_WATCHDOG) == [0] * 4


def test_a_child_does_not_wait_for_its_parents_lock(turning, monkeypatch):
    drive, held, done = turning.plant.robot.drive, threading.Event(), threading.Event()

    def hold():
        with drive._lock:
            held.set()
            done.wait(5.0)

    holder = threading.Thread(target=hold)
    holder.start()
    held.wait()
    with monkeypatch.context() as child:
        child.setattr(drive, "_pid", -1)
        drive.close()
        assert not done.is_set()
    done.set()
    holder.join()


@pytest.fixture
def dry(monkeypatch):
    one = VirtualRobot(monkeypatch, plant_options={"moves": False})
    one.begin()
    return one


def test_a_joint_that_a_hand_turns_in_a_dry_run_keeps_its_torque(dry, monkeypatch):
    for servo in dry.world.servos.values():
        servo.set(table.TORQUE_ENABLE, 1)
    bus, begun_s = dry.plant.robot._servos, dry.clock()
    read = bus.read

    def by_hand():
        passed_s, now = dry.clock() - begun_s, read()
        turns = np.array([min(2.0 * passed_s**2, 1.2), 0.0, 0.0, 0.0])
        return now._replace(angles=now.angles + turns, speeds=np.array([4.0 * passed_s, 0, 0, 0]))

    monkeypatch.setattr(bus, "read", by_hand)
    for _ in range(60):
        if not dry.plant.fault:
            dry.plant.step(SLOW)
    assert lost_torque(dry) == [False] * 4


def test_a_dry_run_tells_of_servos_that_get_hot(dry):
    def runs():
        for _ in range(100):
            dry.plant.step(SLOW)

    dry.fault(what="temperature", ids=[1], value=65)
    with pytest.warns(match="left_pan: temperature: expected below 62 C, got 65 C"):
        runs()
