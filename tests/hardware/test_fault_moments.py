"""At rest within its bound after each fault, at drawn moments, by the emulator's own record."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.hardware.fakes import HEAD
from tests.hardware.virtual import LIMIT_RAD, WATCHDOG_S, VirtualRobot
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.safety.config import SafetyConfig

pytestmark = pytest.mark.slow

MOMENTS = 10
PERIOD_S, LAG_S = HEAD.timing.period_s, HEAD.timing.lag_s
SPEED, ACCELERATION = float(HEAD.actuation.velocity[3]), float(HEAD.actuation.acceleration[3])
REST_S = SPEED / ACCELERATION + 5.0 * LAG_S + 3.0 * PERIOD_S
SILENT_S = 0.1 + 2.0 * PERIOD_S + REST_S
ALONE_S = WATCHDOG_S + 5.0 * LAG_S + 0.02
"""Bound of the servos' own watchdog, s."""
IMAGES_S = SafetyConfig().image_age_s + 0.3 + REST_S
FOLLOWS_S = 0.8 + REST_S

STOPS = {
    "answers lost": ({"what": "lost"}, SILENT_S, "expected an answer of the id"),
    "answers of one lost": ({"what": "lost", "ids": [2]}, SILENT_S, "left_tilt"),
    "damaged": ({"what": "bad-crc"}, SILENT_S, "expected an answer of the id"),
    "cut short": ({"what": "short"}, SILENT_S, "expected an answer of the id"),
    "late": ({"what": "late"}, SILENT_S, "expected an answer of the id"),
    "plug of one pulled": ({"what": "silent", "ids": [3]}, max(SILENT_S, ALONE_S), "right_pan"),
    "cable pulled": ({"what": "unplug"}, ALONE_S, "gone"),
    "overload": ({"what": "overload", "ids": [1]}, 2.0 * PERIOD_S + REST_S, "overload"),
    "reboot": ({"what": "reboot", "ids": [1]}, 12.0 * PERIOD_S + REST_S, "let go"),
    "voltage": ({"what": "voltage", "value": 4.0}, 1.0 + REST_S, "voltage"),
    "hot": ({"what": "temperature", "ids": [2], "value": 69}, 1.1 + REST_S, "temperature"),
    "load": ({"what": "load", "ids": [2], "value": 100}, 4.0 + REST_S, "load"),
    "encoder frozen": (
        {"what": "frozen", "ids": [1]},
        FOLLOWS_S,
        "left_pan: expected the joint to",
    ),
    "stuck": ({"what": "stuck", "ids": [1]}, FOLLOWS_S, "left_pan: expected the joint to follow"),
    "wrong way": ({"what": "wrong-way", "ids": [1]}, FOLLOWS_S, "left_pan"),
}
"""What begins, within which time the joints rest, and what the reason says."""


class Mover:
    """A policy that turns all joints to and fro for ever, by drawn sinusoids."""

    def __init__(self, rng):
        self._rate = 2.0 * np.pi * rng.uniform(0.5, 1.2, 4)
        self._phase = rng.uniform(0.0, 2.0 * np.pi, 4)
        self._peak = rng.uniform(1.5, 3.0, 4)

    def wish(self, time_s):
        wish = np.zeros((1, 7))
        wish[0, 3:] = self._peak * np.sin(self._rate * time_s + self._phase)
        return wish


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
                robot.plant.step(mover.wish(robot.clock()))

        drive(rng.uniform(0.3, 1.5))
        assert robot.plant.fault == ""
        robot.clock.sleep(rng.uniform(0.0, PERIOD_S))
        return SimpleNamespace(robot=robot, drive=drive, since_s=robot.clock())

    return make


def rested_s(now):
    """After how long from the moment on the joints rested; for 0.5 s nobody speaks any more."""
    now.robot.clock.sleep(0.5)
    return now.robot.rested_s(now.since_s)


@pytest.mark.filterwarnings("ignore::vergence.errors.VergenceWarning")  # before the stop
@pytest.mark.parametrize("name", STOPS)
def test_a_fault_brings_the_joints_to_rest_within_its_bound(moment, name):
    request, bound_s, reason = STOPS[name]
    for seed in range(MOMENTS):
        now = moment(seed)
        now.robot.fault(**request)
        now.drive(6.0)
        assert reason in now.robot.plant.fault, seed
        assert rested_s(now) <= bound_s, seed


@pytest.mark.parametrize("eye", [0, 1])
def test_a_camera_that_gives_nothing_new_stops(moment, eye):
    for seed in range(MOMENTS):
        now = moment(seed)
        now.robot.eyes[eye].stalled_s = now.robot.clock()
        now.drive(3.0)
        assert "expected a new image" in now.robot.plant.fault
        assert rested_s(now) <= IMAGES_S, seed


def test_a_stream_that_ends_stops(moment):
    for seed in range(MOMENTS):
        now = moment(seed)
        now.robot.eyes[1].ended_s = now.robot.clock()
        now.drive(3.0)
        assert "the stream ended" in now.robot.plant.fault
        assert rested_s(now) <= 2.0 * PERIOD_S + REST_S, seed


def test_a_command_that_is_no_number_stops(moment):
    for seed in range(MOMENTS):
        now = moment(seed)
        now.robot.plant.step(np.full((1, 7), np.nan))
        assert "nan" in now.robot.plant.fault
        assert rested_s(now) <= PERIOD_S + REST_S, seed


def test_a_policy_that_sleeps_is_stopped(moment):
    for seed in range(MOMENTS):
        now = moment(seed)
        now.robot.clock.sleep(1.0)
        now.drive(0.1)
        assert "of silence" in now.robot.plant.fault
        assert rested_s(now) <= ALONE_S, seed


@pytest.mark.parametrize("pause_s", [0.03, 0.1, 0.2])
def test_a_policy_that_pauses_passes_no_limit(moment, pause_s):
    fast = np.full((1, 7), np.inf)
    for seed in range(MOMENTS):
        now = moment(seed)
        for _ in range(12 + 2 * seed):
            now.robot.plant.step(fast)
        now.robot.clock.sleep(pause_s)
        now.robot.world.to(now.robot.clock())
        assert max(one.q for one in now.robot.world.servos.values()) < LIMIT_RAD, seed


def test_a_process_that_stands_still_is_stopped_by_the_servos(moment):
    for seed in range(MOMENTS):
        now = moment(seed)
        now.robot.clock.stand_still(1.0)
        now.drive(0.1)
        assert "of silence" in now.robot.plant.fault
        assert rested_s(now) <= ALONE_S, seed


def test_closing_brings_the_joints_to_rest_at_once(moment):
    for seed in range(MOMENTS):
        now = moment(seed)
        now.robot.plant.close()
        assert rested_s(now) <= REST_S, seed


@pytest.mark.parametrize("fault", [{"what": "doubled"}, {"what": "lost", "probability": 0.3}])
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
