"""The plant of a real head, its environment, and an evaluation on it, in simulated time."""

import gc
import re

import gymnasium
import numpy as np
import pytest

from tests.hardware.fakes import HEAD
from tests.hardware.test_config import document, load
from tests.hardware.virtual import PORT, VirtualRobot, WatchedWorld
from tests.naming import refused
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
from vergence.hardware import cameras
from vergence.hardware import robot as robot_module
from vergence.hardware.config import load_hardware
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.servos import DynamixelServos
from vergence.hardware.gaze import EPISODE_S, GazeHardwareEnv
from vergence.hardware.plant import HardwarePlant
from vergence.models.toml_table import toml_text


def test_another_head_or_more_than_one_is_refused_before_anything_is_opened(robot):
    refused("num: expected 1", HardwarePlant, HEAD, 2, config=robot.config)
    other = load_head("physical")
    refused("head: expected the head of robot", HardwarePlant, other, config=robot.config)
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
    for period in range(1, 9):
        reading = robot.step([9.0, 9.0, 9.0, 0.5, -0.5, 50.0, 0.011])
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


def test_a_closed_head_takes_no_command_and_closes_twice_without_a_line_too(robot):
    refused("expected a reset first", robot.step, 0.0, error=HardwareError)
    robot.begin()
    robot.fault(what="unplug")
    robot.plant.close()
    robot.plant.close()
    refused("expected a reset first", robot.step, 0.0, error=HardwareError)


def test_a_command_of_another_shape_is_refused(robot):
    robot.begin()
    refused(r"expected shape \(1, 7\), got \(1, 6\)", robot.plant.step, [[0.0] * 6])


def test_a_watchdog_that_trips_ends_a_trial_but_not_the_wait_before_it(robot):
    robot.begin()
    robot.clock.stand_still(1.0)
    robot.step(0.0)
    assert robot.plant.fault == ""
    robot.clock.stand_still(1.0)
    robot.step(0.0)
    assert re.search(r"hear something every 0\.22 s, got", robot.plant.fault)
    robot.plant.close()
    assert robot.registers(table.BUS_WATCHDOG) == [0] * 4


@pytest.mark.slow
def test_a_stop_brakes_before_step_returns_and_latches_until_released(robot):
    robot.begin()
    robot.step(1.0, count=6)
    assert np.abs(robot.world.line.velocities()).max() > 0.4
    robot.step(np.nan)
    assert "got nan" in robot.plant.fault
    assert robot.registers(table.GOAL_VELOCITY) == [0] * 4
    assert robot.registers(table.TORQUE_ENABLE) == [1] * 4
    for call in (lambda: robot.step(0.0), robot.begin, robot.plant.prepare):
        refused("release it first", call, error=HardwareError)
    robot.plant.release()
    assert robot.plant.fault == ""
    robot.begin()
    robot.step(0.0)
    assert robot.plant.fault == ""


def test_an_answer_that_misses_is_counted_and_ends_nothing(robot):
    robot.begin()
    robot.step(0.0)
    before = robot.plant.diagnostics()["missed_answers"]
    robot.fault(what="silent", ids=[3])
    assert np.isfinite(robot.step(0.0).positions).all()
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
    robot.step(0.0)
    assert robot.plant.overruns == 0
    robot.clock.stand_still(3.5 * HEAD.timing.period_s)
    # period 2 was due long ago, and so were 3 and 4
    for period in (4, 5):
        assert robot.step(0.0).time_s[0] == pytest.approx(period * HEAD.timing.period_s)
        assert robot.plant.overruns == 2


def test_a_plant_that_nobody_holds_any_more_is_closed(robot):
    robot.begin()
    robot.step(1.0)
    assert min(robot.registers(table.GOAL_VELOCITY)) > 0
    del robot.plant
    gc.collect()
    assert robot.registers(table.GOAL_VELOCITY) == [0] * 4


# ---- the environment ----


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


def test_an_environment_that_cannot_be_is_refused(config):
    for options, said in (
        ({}, "config: expected the path of a TOML file"),
        ({"config": config, "plant": {}}, "plant: expected none with config"),
        ({"config": config, "plant_options": {}}, "plant_options: expected none with config"),
        ({"config": config, "head": "physical"}, r"head: expected the head of .*robot\.toml"),
        ({"config": config, "duration_s": -1.0}, "duration_s"),
    ):
        refused(said, make, **options)
    refused(r"none\.toml: No such file", make, config="none.toml", error=UnreadableFileError)


def test_spaces_and_plant_are_those_of_the_configured_head(config):
    make(config=config, head="turrets").close()
    with GazeHardwareEnv(config=config.path, head=load_head("turrets")) as env:
        assert env.action_space.shape == (4,)
        assert env.task.head.digest == config.head.digest
        assert isinstance(env.task.plant, HardwarePlant)
        assert env.task.plant.config.path == config.path


@pytest.mark.slow
@pytest.mark.parametrize(("options", "lasts_s"), [({}, EPISODE_S), ({"duration_s": 0.5}, 0.5)])
def test_an_episode_lasts_as_long_as_it_is_told(robot, monkeypatch, options, lasts_s):
    monkeypatch.setattr(gaze_task, "make_plant", lambda *_words, **_options: robot.plant)
    with GazeHardwareEnv(config=robot.config, **options) as env:
        env.reset(seed=0)
        steps, over = 0, False
        while not over:
            _observation, _reward, lost, over, _info = env.step(np.zeros(4, np.float32))
            assert not lost
            steps += 1
        assert steps * HEAD.timing.period_s == pytest.approx(lasts_s)


@pytest.mark.slow
def test_an_evaluation_that_a_pulled_cable_ends_goes_on_where_it_was(tmp_path, monkeypatch):
    make_simulated = gaze_task.make_plant
    desk, run, ran, robots = tmp_path / "desk.toml", tmp_path / "run", [], []
    desk.write_text(toml_text(document() | {"bus": {"port": PORT}}))

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
