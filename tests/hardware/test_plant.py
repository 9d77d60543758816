"""The plant of a real head, on emulated servos behind a pseudo-terminal and cameras of its own."""

import gc
import re
import time
import weakref

import numpy as np
import pytest

from tests.hardware.fakes import HEAD, TAG, FakeClock, LiveCapture, blank, camera_config
from tests.hardware.line import make_servo
from vergence import load_head
from vergence.errors import ChecksFailedError, ConfigurationError, Finding, HardwareError
from vergence.hardware import cameras
from vergence.hardware import plant as plant_module
from vergence.hardware.config import BusConfig, HardwareConfig, ServoConfig, actuator_slots
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.plant import HardwarePlant

PLACES = np.zeros(1, dtype=np.int64)
START = HEAD.rest()[None]
STILL = np.zeros((1, 7))


def servos(start_rad=0.1):
    return [
        make_servo(ident, lower=-3.2, upper=3.2, position_rad=start_rad) for ident in range(1, 5)
    ]


@pytest.fixture
def robot(serve, monkeypatch):
    """Make a plant on servos, and what serves them."""
    captures, plants = [], []

    def open_capture(*_words, **_options):
        captures.append(LiveCapture(blank(HEAD), HEAD.timing.frame_rate_hz))
        return captures[-1]

    monkeypatch.setattr(cameras, "open_capture", open_capture)
    monkeypatch.setattr(plant_module, "check_local_cameras", lambda _config: [])

    def make(own=None, watchdog_s=2.0, **options):
        served = serve(own or servos(), **options)
        config = HardwareConfig(
            path="robot.toml",
            head=HEAD,
            target=TAG,
            bus=BusConfig(port=served.port, watchdog_s=watchdog_s),
            servos=tuple(
                ServoConfig(
                    name=name, slot=slot, id=ident, zero_ticks=2048, sign=1, gear_ratio=1.0,
                    lower_rad=-1.5, upper_rad=1.5,
                )
                for ident, (name, slot) in enumerate(actuator_slots(HEAD).items(), 1)
            ),
            cameras=(camera_config(0), camera_config(1, source="8")),
            pairing_tolerance_s=0.6 * HEAD.timing.frame_s,
            emulator_address="",
        )  # fmt: skip
        plant = HardwarePlant(HEAD, config=config, view_check=False)
        plants.append(weakref.ref(plant))
        plant.captures = captures
        return plant, served

    yield make
    for plant in plants:
        if plant() is not None:
            plant().close()


def test_another_head_or_more_than_one_is_refused_before_anything_is_opened(robot):
    plant, _served = robot()
    with pytest.raises(ConfigurationError, match="num: expected 1"):
        HardwarePlant(HEAD, 2, config=plant.config)
    with pytest.raises(ConfigurationError, match="head: expected the head of robot"):
        HardwarePlant(load_head("physical"), config=plant.config)
    assert plant.captures == []


def test_a_closed_head_takes_no_command_and_closes_twice(robot):
    plant, _served = robot()
    with pytest.raises(HardwareError, match="expected a reset first"):
        plant.step(STILL)
    plant.close()
    plant.close()


@pytest.mark.slow
def test_a_missing_id_is_refused_with_those_that_answer(robot):
    plant, _served = robot(servos()[:2])
    with pytest.raises(
        HardwareError,
        match=r"right_pan: expected a servo with the id 3 .* there are the ids 1, 2",
    ):
        plant.prepare()


@pytest.mark.slow
def test_nothing_has_torque_before_reset_and_preparing_twice_opens_once(robot):
    plant, served = robot()
    plant.prepare()
    plant.prepare()
    assert len(plant.captures) == 2
    for servo in served.line.servos:
        assert servo.get(table.TORQUE_ENABLE) == 0
        assert servo.get(table.OPERATING_MODE) == table.VELOCITY_MODE


@pytest.mark.slow
def test_a_trial_begins_at_rest_at_its_start_and_time_is_the_schedules(robot):
    plant, served = robot()
    reading = plant.reset(PLACES, START)
    assert reading.time_s[0] == 0.0
    assert (reading.frame[0], reading.command.any()) == (0, False)
    assert np.abs(served.line.positions()).max() < 0.012
    told = np.array([[9.0, 9.0, 9.0, 0.5, -0.5, 50.0, 0.011]])
    for _ in range(8):
        reading = plant.step(told)
        # nothing moves that has no servo, and what is said to be sent is what was sent
        assert (reading.command[0, :3] == 0.0).all()
        goals = [servo.get(table.GOAL_VELOCITY) for servo in served.line.servos]
        assert reading.command[0, 3:] == pytest.approx(np.array(goals) * table.TICK_RAD_S)
        periods = reading.time_s[0] / HEAD.timing.period_s
        assert periods == pytest.approx(round(periods), abs=1e-9)
    assert reading.time_s[0] >= 8 * HEAD.timing.period_s - 1e-9
    assert reading.positions[0, 3] > 0.02 > -0.02 > reading.positions[0, 4]
    for wrong, words in (
        (np.zeros(7), r"expected shape \(1, 7\)"),
        ([[0.0] * 6], r"expected shape \(1, 7\), got \(1, 6\)"),
        (np.zeros((1, 7), complex), "expected numbers, got an array of complex128"),
    ):
        with pytest.raises(ConfigurationError, match=words):
            plant.step(wrong)


@pytest.mark.slow
def test_closing_leaves_servos_at_rest_without_a_watchdog(robot):
    plant, served = robot()
    plant.reset(PLACES, START)
    plant.step(np.array([[0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0]]))
    plant.close()
    for servo in served.line.servos:
        assert servo.get(table.GOAL_VELOCITY) == 0
        assert servo.get(table.BUS_WATCHDOG) == 0
    assert [capture.released for capture in plant.captures] == [1, 1]


@pytest.mark.slow
def test_a_watchdog_that_trips_ends_a_trial_but_not_the_wait_before_it(robot):
    plant, served = robot(watchdog_s=0.2)
    plant.reset(PLACES, START)
    trip(plant, served)
    plant.step(STILL)
    trip(plant, served)
    plant.step(STILL)
    assert re.search(r"hear something every 0\.2 s, got", plant.fault)
    plant.close()
    assert [servo.get(table.BUS_WATCHDOG) for servo in served.line.servos] == [0] * 4


def step_until_stopped(plant, requested=STILL):
    """Wish the same until the plant stops, for half a second at most."""
    for _ in range(30):
        plant.step(requested)
        if plant.fault:
            return


@pytest.mark.slow
def test_a_stop_brakes_before_step_returns_and_latches_until_released(robot):
    plant, served = robot()
    plant.reset(PLACES, START)
    fast = np.zeros((1, 7))
    fast[0, 3:] = 1.0
    for _ in range(6):
        plant.step(fast)
    assert np.abs(served.line.velocities()).max() > 0.4
    plant.step(np.full((1, 7), np.nan))
    assert "got nan" in plant.fault
    assert [servo.get(table.GOAL_VELOCITY) for servo in served.line.servos] == [0] * 4
    assert [servo.get(table.TORQUE_ENABLE) for servo in served.line.servos] == [1] * 4
    for call in (lambda: plant.step(STILL), lambda: plant.reset(PLACES, START), plant.prepare):
        with pytest.raises(HardwareError, match="release it first"):
            call()
    plant.release()
    assert plant.fault == ""
    plant.reset(PLACES, START)
    plant.step(STILL)
    assert plant.fault == ""


def trip(plant, served):
    """Let nobody have spoken for longer than the watchdog waits."""
    # the time of the servos and the plant's own record go on, the test does not wait
    for servo in served.line.servos:
        servo.feed_watchdog(time.monotonic() - 1.0)
    with plant._open.drive.exclusive() as line:
        line._fed_s -= 1.0


@pytest.mark.slow
def test_an_answer_that_misses_is_counted_and_a_silent_servo_is_named(robot):
    plant, served = robot()
    plant.reset(PLACES, START)
    plant.step(STILL)
    before = plant.diagnostics()["missed_answers"]
    served.line.servos[2].silent = True
    reading = plant.step(STILL)
    assert np.isfinite(reading.positions).all()
    assert plant.diagnostics()["missed_answers"] > before
    step_until_stopped(plant)
    assert "servos: right_pan: expected an answer of the id 3" in plant.fault


@pytest.mark.slow
def test_one_answer_that_misses_after_a_long_wait_is_no_silence(robot):
    plant, served = robot()
    plant.reset(PLACES, START)
    with plant._open.drive.exclusive() as line:
        line._clock = FakeClock(time.monotonic() + 30.0)
    served.line.servos[0].silent = True
    plant._sense()
    assert np.isfinite(plant._history.newest()[1]).all()


@pytest.mark.slow
def test_a_camera_that_ends_ends_the_trial(robot):
    plant, _served = robot()
    plant.reset(PLACES, START)
    plant.captures[1].end()
    plant._open.eyes.threads[1].join()
    plant.step(STILL)
    assert "cameras.right: 8: the stream ended" in plant.fault


@pytest.mark.slow
def test_a_line_that_is_gone_still_closes(robot):
    plant, served = robot()
    plant.reset(PLACES, START)
    served.hang_up()
    plant.step(STILL)
    assert "gone" in plant.fault
    plant.close()
    assert [capture.released for capture in plant.captures] == [1, 1]


def test_a_missed_period_is_skipped_on_the_grid(robot):
    plant, _served = robot()
    clock = FakeClock()
    plant._clock, plant._sleep = clock, clock.sleep
    plant.begun_s = clock.now
    plant._wait()
    assert (plant._tick, plant.overruns) == (1, 0)
    clock.sleep(3.5 * plant._period_s)
    plant._wait()
    # period 2 was due long ago, and so were 3 and 4
    assert (plant._tick, plant.overruns) == (4, 2)
    plant._wait()
    assert clock.now == pytest.approx(plant.begun_s + 5 * plant._period_s)


@pytest.mark.slow
def test_a_servo_that_has_let_go_ends_the_trial(robot):
    faults = {
        "let go": lambda servo: servo.reboot(),
        "overload": lambda servo: servo.set_hardware_errors(0b100000),
    }
    for told, lets_go in faults.items():
        plant, served = robot()
        plant.reset(PLACES, START)
        lets_go(served.line.servos[1])
        step_until_stopped(plant)
        assert re.search(rf"servos: left_tilt: .*{told}", plant.fault)
        plant.close()


@pytest.mark.slow
def test_a_plant_that_nobody_holds_any_more_is_closed(robot):
    plant, served = robot()
    plant.reset(PLACES, START)
    plant.step(np.array([[0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0]]))
    captures = plant.captures
    del plant
    gc.collect()
    assert [servo.get(table.GOAL_VELOCITY) for servo in served.line.servos] == [0] * 4
    assert all(capture.released for capture in captures)


def test_what_is_wrong_with_cameras_and_servos_is_told_at_once(robot, monkeypatch):
    own = servos()
    own[2].set(table.HOMING_OFFSET, 5)
    plant, served = robot(own)
    dark = Finding(part="cameras.left", problem="expected images, got none")
    monkeypatch.setattr(plant_module, "check_local_cameras", lambda _config: [dark])
    with pytest.raises(ChecksFailedError) as failed:
        plant.prepare()
    assert [one.part for one in failed.value.findings] == ["servos: right_pan", "cameras.left"]
    assert plant.captures == []
    assert [servo.get(table.TORQUE_ENABLE) for servo in served.line.servos] == [0] * 4
