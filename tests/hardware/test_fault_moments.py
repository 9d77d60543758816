"""At rest within its bound after each fault, at drawn moments, by the emulator's own record."""

import itertools
import os
from functools import partial

import numpy as np
import pytest

from benchmarks.faults import GOES_ON, Bounds, Mover, cases
from tests.hardware.virtual import LIMIT_RAD, VirtualRobot, virtual_config
from tests.naming import named
from vergence.hardware.dynamixel import control_table as table

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::vergence.errors.VergenceWarning"),  # before the stop
]
MOMENTS = range(int(os.environ.get("VERGENCE_FAULT_MOMENTS", "10")))
MORE = pytest.param(MOMENTS[1:], marks=pytest.mark.nightly)
BOUNDS = Bounds(virtual_config())


class Moment:
    """A robot whose joints turn, at a drawn moment of a trial."""

    def __init__(self, monkeypatch, seed):
        rng = np.random.default_rng((17, seed))
        self.robot, self._mover = VirtualRobot(monkeypatch), Mover(rng)
        self.robot.begin()
        self.drive(rng.uniform(0.3, 1.0))
        assert self.robot.plant.fault == ""
        self.robot.clock.sleep(rng.uniform(0.0, BOUNDS.period_s))

    def drive(self, seconds):
        self.robot.follow(self._mover.command, seconds)


@pytest.fixture
def moment(monkeypatch):
    return partial(Moment, monkeypatch)


def emulated(request):
    def happen(now):
        now.robot.fault(**request)
        now.drive(6.0)

    return happen


def of_eye(eye, name):
    def happen(now):
        setattr(now.robot.eyes[eye], name, now.robot.clock())
        now.drive(3.0)

    return happen


def silence(pause):
    """A policy that sleeps, or a process that stands still."""

    def happen(now):
        getattr(now.robot.clock, pause)(1.0)
        now.drive(0.1)

    return happen


STOPS = {
    name: (emulated(case.request), case.reason, case.bound_s)
    for name, case in cases(BOUNDS).items()
    if "eye" not in case.request
} | {
    "no new image of the left": (of_eye(0, "stalled_s"), "a new image", BOUNDS.image_s),
    "no new image of the right": (of_eye(1, "stalled_s"), "a new image", BOUNDS.image_s),
    "a stream that ends": (
        of_eye(1, "ended_s"), "the stream ended", BOUNDS.period_s + BOUNDS.leave_s,
    ),
    "a command that is no number": (
        lambda now: now.robot.step(np.nan), "nan", BOUNDS.leave_s,
    ),
    "a policy that sleeps": (silence("sleep"), "of silence", BOUNDS.alone_s),
    "a process that stands still": (silence("stand_still"), "of silence", BOUNDS.alone_s),
    "the end": (lambda now: now.robot.plant.close(), "", BOUNDS.rest_s),
}  # fmt: skip
"""By name: what happens, a part of the reason of the stop, and the bound, s."""

ELSEWHERE = {
    # their lines: test_robot_doc
    "answers of one lost", "answers late", "cable pulled", "voltage", "overload",
    # with friction, and the way that they go: test_drive
    "encoder blind", "encoder's fault bit", "motor inverted",
    # beyond no limit: test_drive
    "joint stuck",
    # as those that are damaged, warm and of the right eye
    "answers cut short", "load", "no new image of the left",
}  # fmt: skip
"""Stops that quick tests show, if not at drawn moments."""
BY_DAY = [name for name in STOPS if name not in ELSEWHERE]


def assert_rests(moment, name, seeds):
    """Each time the joints rest within the bound; for 0.5 s nobody speaks any more."""
    happen, reason, bound_s = STOPS[name]
    for seed in seeds:
        with named(name, seed):
            now = moment(seed)
            since_s = now.robot.clock()
            happen(now)
            assert reason in now.robot.plant.fault
            now.robot.clock.sleep(0.5)
            assert now.robot.rested_s(since_s) <= bound_s


@pytest.mark.parametrize("part", range(2))
def test_a_fault_brings_the_joints_to_rest_within_its_bound(moment, part):
    for name in BY_DAY[part::2]:
        assert_rests(moment, name, [0])


@pytest.mark.nightly
@pytest.mark.parametrize("part", range(4))
def test_at_more_moments_a_fault_brings_the_joints_to_rest_within_its_bound(moment, part):
    for name in list(STOPS)[part::4]:
        assert_rests(moment, name, MOMENTS[name in BY_DAY :])


@pytest.mark.parametrize("seeds", [[1], MORE])
def test_a_policy_that_pauses_passes_no_limit(moment, seeds):
    for seed, pause_s in itertools.product(seeds, (0.03, 0.2)):
        with named(pause_s, seed):
            robot = moment(seed).robot
            robot.step(np.inf, count=12 + 2 * seed)
            robot.clock.sleep(pause_s)
            robot.world.advance_to(robot.clock())
            assert max(one.q for one in robot.world.servos.values()) < LIMIT_RAD


@pytest.mark.parametrize("seeds", [[0], MORE])
def test_a_line_that_is_not_clean_goes_on(moment, seeds):
    faults = [one for one in GOES_ON.values() if one["what"] in ("doubled", "lost")]
    for fault, seed in itertools.product(faults, seeds):
        with named(fault, seed):
            now = moment(seed)
            now.robot.fault(**fault)
            now.drive(0.8)
            assert now.robot.plant.fault == ""


def test_a_stop_keeps_the_torque_but_for_servos_that_are_hot(moment):
    now = moment(0)
    now.robot.fault(what="temperature", ids=[2], value=69)
    now.drive(2.0)
    assert now.robot.registers(table.TORQUE_ENABLE) == [1, 0, 1, 1]


@pytest.mark.filterwarnings("default::vergence.errors.VergenceWarning")
def test_warm_servos_are_told_of_and_go_on(moment):
    now = moment(0)
    now.robot.fault(what="temperature", ids=[2], value=64)
    with pytest.warns(match="left_tilt: temperature: expected below 62 C, got 64 C"):
        now.drive(2.5)
    assert now.robot.plant.fault == ""
