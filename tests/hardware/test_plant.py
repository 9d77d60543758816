"""The plant of a real head, its environment, and an evaluation on it."""

import dataclasses
import gc
import re

import gymnasium
import numpy as np
import pytest

import vergence
from tests.hardware.fakes import HEAD, LiveCapture, blank
from tests.hardware.line import desk_config, make_servo
from tests.hardware.test_config import document, load
from tests.hardware.virtual import PORT, VirtualRobot, WatchedWorld
from vergence import load_head
from vergence.envs import task as gaze_task
from vergence.errors import (
    ChecksFailedError,
    ConfigurationError,
    Finding,
    HardwareError,
    UnreadableFileError,
)
from vergence.eval.comparison.config import EvaluateConfig
from vergence.eval.robot.evaluate import evaluate_on_robot, read_begun_config
from vergence.hardware import cameras, plant
from vergence.hardware import robot as robot_module
from vergence.hardware.config import load_hardware
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.servos import DynamixelServos
from vergence.hardware.gaze import EPISODE_S, GazeHardwareEnv
from vergence.hardware.plant import HardwarePlant
from vergence.models.toml_table import toml_text

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


@pytest.fixture
def config(tmp_path, monkeypatch):
    """A configuration of hardware that fails the test if it is opened."""

    def opened(*_words):
        pytest.fail("nothing may be opened before the first reset")

    monkeypatch.setattr(DynamixelServos, "open", opened)
    monkeypatch.setattr(cameras, "EyeThread", opened)
    return load(tmp_path, document())


def make(**options):
    return gymnasium.make("vergence/GazeHardware-v0", **options)


def test_it_needs_a_configuration():
    with pytest.raises(ConfigurationError, match="config: expected the path of a TOML file"):
        make()
    with pytest.raises(UnreadableFileError, match=r"none\.toml: No such file"):
        make(config="none.toml")


def test_the_plant_is_given_by_the_configuration(config):
    for option in ("plant", "plant_options"):
        with pytest.raises(ConfigurationError, match=f"{option}: expected none with config"):
            GazeHardwareEnv(config=config, **{option: {}})


def test_another_head_is_refused_and_the_same_one_taken(config):
    with pytest.raises(ConfigurationError, match=r"head: expected the head of .*robot\.toml"):
        make(config=config, head="physical")
    make(config=config, head="turrets").close()
    make(config=config.path, head=vergence.load_head("turrets")).close()


def test_spaces_and_plant_are_those_of_the_configured_head(config):
    with GazeHardwareEnv(config=config) as env:
        assert env.action_space.shape == (4,)
        assert env.task.head.digest == config.head.digest
        assert isinstance(env.task.plant, plant.HardwarePlant)
        assert env.task.plant.config is config


@pytest.fixture
def in_view(monkeypatch):
    """Robots on time, that always see the target straight ahead."""

    def reset(self, _ids, positions):
        self.reading.time_s[:] = 0.0
        self.reading.positions[:] = self.reading.positions_at_exposure[:] = positions
        return self.reading

    def step(self, _command):
        now = self.reading
        now.time_s[:] += self.head.timing.period_s
        now.frame[:] += 1
        now.exposure_s[:] = now.time_s - self.head.timing.latency_s
        now.received_s[:] = now.joints_s[:] = now.time_s
        now.pixels[:], now.visible[:] = self.head.cameras.principal, True
        return now

    for method in (reset, step):
        monkeypatch.setattr(plant.HardwarePlant, method.__name__, method)
    monkeypatch.setattr(plant.HardwarePlant, "prepare", lambda _self: None)


@pytest.mark.slow
@pytest.mark.parametrize(("options", "lasts_s"), [({}, EPISODE_S), ({"duration_s": 0.5}, 0.5)])
def test_an_episode_lasts_as_long_as_it_is_told(config, in_view, options, lasts_s):
    with GazeHardwareEnv(config=config, **options) as env:
        env.reset(seed=0)
        steps, over = 0, False
        while not over:
            _observation, _reward, lost, over, _info = env.step(np.zeros(4, np.float32))
            assert not lost
            steps += 1
        assert steps * env.task.head.timing.period_s == pytest.approx(lasts_s)


def test_a_length_that_is_none_is_refused(config):
    with pytest.raises(ConfigurationError, match="duration_s"):
        GazeHardwareEnv(config=config, duration_s=-1.0)


@pytest.mark.slow
def test_an_evaluation_that_a_pulled_cable_ends_goes_on_where_it_was(tmp_path, monkeypatch):
    make_simulated = gaze_task.make_plant
    desk, run, ran, robots = tmp_path / "desk.toml", tmp_path / "run", [], []
    values = document()
    values["bus"] = {"port": PORT}
    desk.write_text(toml_text(values))

    def make_plant(name, head, num, log=None, **options):
        if name != "hardware":
            return make_simulated(name, head, num, **options)
        world = WatchedWorld(head, np.array([0.05, -0.1, 1.0]), latency_s=head.timing.latency_s)
        options = {"log": log, "view_check": False}
        robots.append(VirtualRobot(monkeypatch, world, load_hardware(desk), plant_options=options))
        return robots[-1].plant

    def note(done, _total):
        ran.append(done)
        if ran == [0, 1]:
            robots[-1].fault(what="unplug")

    monkeypatch.setattr(gaze_task, "make_plant", make_plant)
    config = EvaluateConfig(
        controllers=("ibvs-tuned",), plants=("hardware",), hardware=desk, stage="still",
        scenarios=("workspace",), episodes=2,
    )  # fmt: skip
    with pytest.raises(HardwareError, match="the serial line is gone"):
        evaluate_on_robot(config, run, progress=note)
    found = evaluate_on_robot(read_begun_config(run), run, progress=note, resume=True)
    assert ran == [0, 1, 1, 2]
    assert len(robots) == 2
    trials = found.trials()
    assert len(trials) == 2
    assert (trials["settle_2px_s"] >= trials["bound_2px_s"]).all()
    assert "hardware is a robot" in found.notes[-1]
    desk.write_text(desk.read_text().replace("[cameras.left]", "[cameras.left]\nlatency_s = 0.01"))
    with pytest.raises(ConfigurationError, match=r"resume: expected cameras of .*0\.01"):
        evaluate_on_robot(read_begun_config(run), run, resume=True)
