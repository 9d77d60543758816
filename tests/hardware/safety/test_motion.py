"""No command leads beyond a bound in the safety's own model, whatever is requested."""

import itertools

import numpy as np
import pytest

from benchmarks.safety import POLICIES, Joints, exceeded
from tests.naming import named
from vergence import load_head
from vergence.hardware.safety.limits import ForbiddenPosture, JointMotionLimiter, SafetyConfig

NIGHTLY = [pytest.mark.nightly]
TURRETS = load_head("turrets")
LOWER, UPPER = TURRETS.actuation.lower, TURRETS.actuation.upper


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [range(3), pytest.param(range(3, 200), marks=NIGHTLY)])
def test_no_command_leads_beyond_a_bound(seeds):
    for seed, style in itertools.product(seeds, POLICIES):
        with named(seed, style):
            beyond = exceeded(np.random.default_rng((7, seed)), style)
            # rad, rad/s, share of the acceleration, whether inside a forbidden posture
            assert (beyond <= [0.0, 1e-9, 1e-9, 0.0]).all()
            for how in ("late", "ends"):
                beyond = exceeded(np.random.default_rng((8, seed)), style, how=how)
                assert (beyond[[0, 1, 3]] <= [0.0, 1e-9, 0.0]).all(), how


def drive(requested, start=None, config=None, steps=240):
    """Angles of the turrets after one constant request for 4 s."""
    motion = JointMotionLimiter(TURRETS, LOWER, UPPER, config or SafetyConfig())
    joints = Joints(TURRETS, np.zeros(7) if start is None else start)
    for _ in range(steps):
        command = motion.limit_velocities(joints.angles, joints.speeds, requested, motion.max_speed)
        motion.advance(command)
        joints.step(command)
    return joints.angles


def test_a_joint_comes_close_to_its_limit():
    assert np.abs(drive(np.full(7, np.inf)) - UPPER)[3:].max() < 0.02
    assert np.abs(drive(np.full(7, -np.inf)) - LOWER)[3:].max() < 0.02


def test_a_joint_beyond_its_limit_may_only_come_back():
    beyond = np.zeros(7)
    beyond[3:] = UPPER[3:] + 0.05
    motion = JointMotionLimiter(TURRETS, LOWER, UPPER, SafetyConfig())
    out = motion.limit_velocities(beyond, np.zeros(7), np.full(7, 1.0), motion.max_speed)
    back = motion.limit_velocities(beyond, np.zeros(7), np.full(7, -1.0), motion.max_speed)
    assert (out == 0.0).all()
    assert (back[3:] == -1.0).all()


def test_a_measured_speed_that_the_model_does_not_know_counts():
    motion = JointMotionLimiter(TURRETS, LOWER, UPPER, SafetyConfig())
    near = np.zeros(7)
    near[3:] = UPPER[3:] - 0.1
    pushed = np.zeros(7)
    pushed[3:] = 4.0
    command = motion.limit_velocities(near, pushed, np.full(7, 1.0), motion.max_speed)
    assert (command[3:] == 0.0).all()


def test_a_request_within_all_bounds_is_the_command():
    motion = JointMotionLimiter(TURRETS, LOWER, UPPER, SafetyConfig())
    requested = np.array([0.0, 0.0, 0.0, 1.0, -0.5, 0.3, 0.0])
    limited = motion.limit_velocities(np.zeros(7), np.zeros(7), requested, motion.max_speed)
    assert (limited == requested).all()


def test_an_eye_slides_along_a_forbidden_posture():
    lower, upper = np.array([0.5, -1.0]), np.array([1.0, 0.6])
    frame = ForbiddenPosture(name="the frame", slots=(3, 4), lower=lower, upper=upper)
    config = SafetyConfig(forbidden=(frame,))
    requested = np.zeros(7)
    requested[3], requested[4] = 1.0, 0.25
    end = drive(requested, config=config)
    # held before the face while the tilt is inside the range, free once it is above it
    assert end[4] > 0.6
    assert end[3] > 1.0
    stay = requested.copy()
    stay[4] = 0.0
    assert 0.4 < drive(stay, config=config)[3] < 0.5
