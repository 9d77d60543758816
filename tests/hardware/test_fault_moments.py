"""At rest within its bound after each fault, at drawn moments, by the emulator's own record."""

import os
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.faults import GOES_ON, Bounds, Mover, cases
from tests.hardware.virtual import LIMIT_RAD, VirtualRobot, virtual_config
from vergence.hardware.dynamixel import control_table as table

pytestmark = pytest.mark.slow

MOMENTS = int(os.environ.get("VERGENCE_FAULT_MOMENTS", "10"))
BOUNDS = Bounds(virtual_config())
LINE = ("doubled", "lost")
STOPS = {name: case for name, case in cases(BOUNDS).items() if "eye" not in case.request}


@pytest.fixture
def moment(monkeypatch):
    """A robot whose joints turn, at a drawn moment of a trial."""

    def make(seed):
        rng = np.random.default_rng((17, seed))
        robot = VirtualRobot(monkeypatch)
        robot.begin()
        mover = Mover(rng)

        def drive(seconds):
            until_s = robot.clock() + seconds
            while robot.clock() < until_s and not robot.plant.fault:
                robot.plant.step(mover.command(robot.clock()))

        drive(rng.uniform(0.3, 1.5))
        assert robot.plant.fault == ""
        robot.clock.sleep(rng.uniform(0.0, BOUNDS.period_s))
        return SimpleNamespace(robot=robot, drive=drive, since_s=robot.clock())

    return make


def rested_s(now):
    """After how long from the moment on the joints rested; for 0.5 s nobody speaks any more."""
    now.robot.clock.sleep(0.5)
    return now.robot.rested_s(now.since_s)


@pytest.mark.filterwarnings("ignore::vergence.errors.VergenceWarning")  # before the stop
@pytest.mark.parametrize("name", STOPS)
def test_a_fault_brings_the_joints_to_rest_within_its_bound(moment, name):
    case = STOPS[name]
    for seed in range(MOMENTS):
        now = moment(seed)
        now.robot.fault(**case.request)
        now.drive(6.0)
        assert case.reason in now.robot.plant.fault, seed
        assert rested_s(now) <= case.bound_s, seed


@pytest.mark.parametrize("eye", [0, 1])
def test_a_camera_that_gives_nothing_new_stops(moment, eye):
    for seed in range(MOMENTS):
        now = moment(seed)
        now.robot.eyes[eye].stalled_s = now.robot.clock()
        now.drive(3.0)
        assert "expected a new image" in now.robot.plant.fault
        assert rested_s(now) <= BOUNDS.image_s, seed


def test_a_stream_that_ends_stops(moment):
    for seed in range(MOMENTS):
        now = moment(seed)
        now.robot.eyes[1].ended_s = now.robot.clock()
        now.drive(3.0)
        assert "the stream ended" in now.robot.plant.fault
        assert rested_s(now) <= BOUNDS.period_s + BOUNDS.leave_s, seed


def test_a_command_that_is_no_number_stops(moment):
    for seed in range(MOMENTS):
        now = moment(seed)
        now.robot.plant.step(np.full((1, 7), np.nan))
        assert "nan" in now.robot.plant.fault
        assert rested_s(now) <= BOUNDS.leave_s, seed


def test_a_policy_that_sleeps_is_stopped(moment):
    for seed in range(MOMENTS):
        now = moment(seed)
        now.robot.clock.sleep(1.0)
        now.drive(0.1)
        assert "of silence" in now.robot.plant.fault
        assert rested_s(now) <= BOUNDS.alone_s, seed


@pytest.mark.parametrize("pause_s", [0.03, 0.1, 0.2])
def test_a_policy_that_pauses_passes_no_limit(moment, pause_s):
    fast = np.full((1, 7), np.inf)
    for seed in range(MOMENTS):
        now = moment(seed)
        for _ in range(12 + 2 * seed):
            now.robot.plant.step(fast)
        now.robot.clock.sleep(pause_s)
        now.robot.world.advance_to(now.robot.clock())
        assert max(one.q for one in now.robot.world.servos.values()) < LIMIT_RAD, seed


def test_a_process_that_stands_still_is_stopped_by_the_servos(moment):
    for seed in range(MOMENTS):
        now = moment(seed)
        now.robot.clock.stand_still(1.0)
        now.drive(0.1)
        assert "of silence" in now.robot.plant.fault
        assert rested_s(now) <= BOUNDS.alone_s, seed


def test_closing_brings_the_joints_to_rest_at_once(moment):
    for seed in range(MOMENTS):
        now = moment(seed)
        now.robot.plant.close()
        assert rested_s(now) <= BOUNDS.rest_s, seed


@pytest.mark.parametrize("fault", [one for one in GOES_ON.values() if one["what"] in LINE])
def test_a_line_that_is_not_clean_goes_on(moment, fault):
    for seed in range(MOMENTS):
        now = moment(seed)
        now.robot.fault(**fault)
        now.drive(1.5)
        assert now.robot.plant.fault == "", seed


def test_a_stop_keeps_the_torque_but_for_servos_that_are_hot(moment):
    now = moment(0)
    now.robot.fault(what="temperature", ids=[2], value=69)
    now.drive(2.0)
    torque = {one.id: one.get(table.TORQUE_ENABLE) for one in now.robot.world.servos.values()}
    assert torque == {1: 1, 2: 0, 3: 1, 4: 1}


def test_warm_servos_are_told_of_and_go_on(moment):
    now = moment(0)
    now.robot.fault(what="temperature", ids=[2], value=64)
    with pytest.warns(match="left_tilt: temperature: expected below 62 C, got 64 C"):
        now.drive(2.5)
    assert now.robot.plant.fault == ""
