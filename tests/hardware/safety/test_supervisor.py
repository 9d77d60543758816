"""Verdicts on a robot that works, and on each thing that can be wrong with it."""

import numpy as np
import pytest

from vergence import load_head
from vergence.hardware.safety.limits import ForbiddenPosture, SafetyConfig
from vergence.hardware.safety.supervisor import RobotState, Supervisor, Verdict

HEAD = load_head("turrets")
NAMES = {"left_pan": 3, "left_tilt": 4, "right_pan": 5, "right_tilt": 6}
PERIOD_S = HEAD.timing.period_s
LEFT_PAN = np.eye(7)[3]


class Robot:
    """A robot in simulated time; `follows` gives its joints' speeds for the commands."""

    def __init__(self, follows=lambda sent: sent, **bounds):
        limits = HEAD.actuation.lower, HEAD.actuation.upper
        self.supervisor = Supervisor(SafetyConfig(**bounds), HEAD, *limits, NAMES)
        self.follows = follows
        self.now_s, self.angles, self.speeds = 10.0, np.zeros(7), np.zeros(7)
        self.supervisor.begin(self.now_s)

    def step(self, requested=None, **changes):
        """One period; what is sent. What differs from a healthy state is given."""
        now = {
            "now_s": self.now_s, "actuator_angles": self.angles, "actuator_speeds": self.speeds,
            "joint_angles": self.angles, "reading_age_s": np.zeros(7),
            "images_received_s": np.full(2, self.now_s), "target_visible": True,
            "target_eye_angles": np.zeros(4),
        }  # fmt: skip
        state = RobotState(**now | changes)
        sent = self.supervisor.command(state, np.zeros(7) if requested is None else requested)
        self.supervisor.on_sent(sent)
        self.speeds = self.follows(sent)
        self.angles = self.angles + PERIOD_S * self.speeds
        self.now_s += PERIOD_S
        return sent

    def run(self, seconds, requested=None, **changes):
        """Some time; after how long it was stopped, s; None if it was not."""
        for period in range(round(seconds / PERIOD_S)):
            self.step(requested() if callable(requested) else requested, **changes)
            if self.supervisor.fault:
                return period * PERIOD_S
        return None

    def prove(self):
        """Move all joints as far as they need to be trusted, and back."""
        for side in (1.0, -1.0):
            for _ in range(30):
                self.step(side * np.full(7, 0.3))
        for _ in range(60):
            self.step()


def test_a_joint_is_slow_until_it_has_followed():
    robot, fast = Robot(), 10.0 * LEFT_PAN
    first = robot.step(fast)[3]
    assert first == pytest.approx(0.1 * HEAD.actuation.velocity[3])
    for _ in range(30):
        last = robot.step(fast)[3]
    assert last > 3.0


def test_a_stop_brakes_within_the_acceleration_and_latches():
    robot = Robot()
    robot.prove()
    for _ in range(15):
        robot.step(4.0 * LEFT_PAN)
    assert robot.speeds[3] > 3.0
    sent = [robot.step(np.full(7, np.nan))[3]]
    while not robot.supervisor.at_rest:
        sent.append(robot.step(4.0 * LEFT_PAN)[3])
    assert robot.supervisor.verdict is Verdict.STOP
    assert 1 < len(sent) < 15
    assert (np.diff(sent) <= 0.0).all()
    assert (robot.step(4.0 * LEFT_PAN) == 0.0).all()
    robot.supervisor.stop("another")
    assert "nan" in robot.supervisor.fault


def test_old_angles_stop():
    robot = Robot()
    robot.step(reading_age_s=0.14 * LEFT_PAN)
    assert robot.supervisor.fault == ""
    robot.step(reading_age_s=0.16 * LEFT_PAN)
    assert "expected the joints' angles within" in robot.supervisor.fault


def test_a_camera_without_images_stops():
    for eye, name in enumerate(("left", "right")):
        robot, images_s = Robot(image_age_s=0.3), np.full(2, 1e9)
        images_s[eye] = 10.0
        assert robot.run(1.0, images_received_s=images_s) == pytest.approx(0.3, abs=1.1 * PERIOD_S)
        assert f"cameras.{name}: expected a new image within 0.3 s" in robot.supervisor.fault


@pytest.mark.parametrize(
    ("gain", "speed", "bound_s"),
    [(0.0, 1.0, 0.8), (-1.0, 1.0, 0.8), (3.0, 1.0, 0.8), (0.0, 0.04, 5.0), (-1.0, 0.06, 5.0)],
)
def test_a_joint_that_does_not_follow_stops(gain, speed, bound_s):
    robot = Robot(lambda sent: gain * sent)
    assert robot.run(6.0, speed * LEFT_PAN) < bound_s
    assert "left_pan: expected the joint to follow its commands" in robot.supervisor.fault


@pytest.mark.nightly
def test_a_loaded_and_late_joint_follows():
    sent = [np.zeros(7)] * 6  # 100 ms later than the model has it

    def late_and_slow(command):
        sent.append(command)
        return 0.8 * sent.pop(0)

    robot, rng = Robot(late_and_slow), np.random.default_rng(3)
    robot.prove()
    for _ in range(20):
        requested = rng.normal(0.0, 1.0, 7)
        assert robot.run(0.3, requested, images_received_s=None) is None, robot.supervisor.fault


def test_a_joint_that_is_pushed_beyond_its_limit_stops():
    robot = Robot()
    robot.angles = HEAD.actuation.upper + 0.1 * LEFT_PAN
    robot.step()
    assert "left_pan: expected -3.140 to 3.140 rad, got 3.240 rad" in robot.supervisor.fault


def test_a_forbidden_posture_stops():
    far = np.full(2, 0.1)
    frame = ForbiddenPosture(name="the frame", slots=(3, 4), lower=-far, upper=far)
    robot = Robot(forbidden=(frame,))
    robot.step()
    assert "'the frame'" in robot.supervisor.fault


@pytest.mark.nightly
def test_missed_periods_stop_beyond_their_share():
    robot = Robot(overruns=0.3)
    robot.step(missed_periods=5)  # one long pause is no slow machine
    assert robot.run(4.0, missed_periods=0) is None
    few, many = Robot(overruns=0.3), Robot(overruns=0.3)
    for period in range(240):
        few.step(missed_periods=int(period % 4 == 0))
        many.step(missed_periods=int(period % 2 == 0))
    assert few.supervisor.fault == ""
    assert "of the 120 periods of 2 s to be missed" in many.supervisor.fault


def swing(robot, goal=lambda _side: 0.0):
    """Turn to and fro five times a second; whether it was stopped."""
    robot.prove()
    for period in range(240):
        side = 1.0 if period // 6 % 2 else -1.0
        robot.step(2.0 * side * LEFT_PAN, target_eye_angles=np.full(4, goal(side)))
    return bool(robot.supervisor.fault)


@pytest.mark.slow
def test_a_policy_that_swings_stops_unless_its_target_does():
    robot = Robot()
    assert swing(robot)
    assert "left_pan swinging at speed" in robot.supervisor.fault
    assert not swing(Robot(), lambda side: 0.15 * side)


@pytest.mark.slow
def test_a_lost_target_holds_until_it_is_seen_again():
    robot = Robot(lost_s=0.3)
    robot.prove()
    for _ in range(15):
        assert robot.step(LEFT_PAN, target_visible=False)[3] == pytest.approx(1.0)
    for _ in range(30):
        robot.step(LEFT_PAN, target_visible=False)
    assert robot.supervisor.verdict is Verdict.HOLD
    assert (robot.step(LEFT_PAN, target_visible=False) == 0.0).all()
    assert robot.step(LEFT_PAN)[3] > 0.0
    assert robot.run(3.0, 0.1 * LEFT_PAN) is None
    assert robot.supervisor.verdict is Verdict.GO


@pytest.mark.slow
def test_a_search_turns_both_eyes_slowly_over_the_field_of_view():
    robot = Robot(lost_s=0.3, search=True)
    robot.prove()
    seen = []
    for _ in range(round(10.0 / PERIOD_S)):
        robot.step(target_visible=False)
        assert np.abs(robot.speeds).max() < 1.0
        seen.append(robot.angles[3:].copy())
    assert robot.supervisor.verdict is Verdict.SEARCH
    assert robot.supervisor.fault == ""
    assert (np.ptp(seen, axis=0) > 0.6).all()


def test_nothing_of_images_counts_on_the_way_to_a_trial():
    robot = Robot(image_age_s=0.1, lost_s=0.1)
    assert robot.run(2.0, 0.3 * LEFT_PAN, images_received_s=None, target_visible=False) is None
    assert robot.supervisor.verdict is Verdict.GO


@pytest.mark.parametrize("emulated", [True, False])
def test_a_fault_of_an_emulated_head_names_the_machine_that_it_shares(emulated):
    limits = HEAD.actuation.lower, HEAD.actuation.upper
    supervisor = Supervisor(SafetyConfig(), HEAD, *limits, NAMES, emulated=emulated)
    supervisor.stop("servos: left_pan: stuck; cure: look at it")
    assert ("shares this machine" in supervisor.fault) == emulated
