"""Between joints and ticks: signs, zeros, gears, what is believed, and what is rounded off."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.hardware.fakes import FakeClock, robot_config
from tests.hardware.line import TimelessLine, make_servo, open_timeless
from vergence import load_head
from vergence.hardware.config import BusConfig
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.servos import JointAngles, ServoReading

TURRETS, ICUB = load_head("turrets"), load_head("icub")
TICK_RAD, TICK_RAD_S = table.TICK_RAD, table.TICK_RAD_S
WIRINGS = st.tuples(st.sampled_from([1, -1]), st.sampled_from([0.5, 1.0]), st.integers(0, 4095))


def eyes(*values):
    return np.array([0.0, 0.0, 0.0, *values])


class Rig:
    """Emulated servos without torque, and the plant's own view of them, in simulated time."""

    def __init__(self, head=TURRETS, wiring=(1, 1.0, 2048), turns_off=0, **options):
        sign, gear_ratio, zero = wiring
        config = robot_config(BusConfig(port=TimelessLine.port), head)
        wired = {"sign": sign, "gear_ratio": gear_ratio, "zero": zero}
        servos = tuple(dataclasses.replace(servo, **wired) for servo in config.servos)
        actuation, self.head, self.clock = head.actuation, head, FakeClock(0.0)
        wired = {"sign": sign, "gear_ratio": gear_ratio, "lower": -np.inf, "upper": np.inf}
        wired["zero_ticks"] = zero + turns_off * table.TICKS_PER_TURN
        self.servos = [
            make_servo(
                one.id, lag_s=float(head.timing.lag_s * actuation.lag_ratio[one.slot]),
                acceleration=float(actuation.acceleration[one.slot]), **wired, **options,
            )
            for one in servos
        ]  # fmt: skip
        self.bus = open_timeless(
            dataclasses.replace(config, servos=servos), self.servos, self.clock
        )
        self.joints = JointAngles(servos, head)
        self.sense()

    def sense(self):
        self.joints.update(self.bus.read())

    def send(self, velocity):
        """What the servos get, in ticks, and what it says that it has sent."""
        sent = self.joints.velocities(self.bus.send(self.joints.shaft_speeds(velocity)))
        return [one.get(table.GOAL_VELOCITY) for one in self.servos], sent

    def step(self, velocity, count=1):
        """Some control periods, as the plant makes them; what it says that it has sent."""
        sent = []
        for _ in range(count):
            sent.append(self.send(velocity)[1])
            self.clock.sleep(self.head.timing.period_s)
            self.sense()
        return sent

    def switch_on(self):
        self.bus.switch_on(np.ones(len(self.servos), bool))
        return self

    @property
    def true(self):
        """(7,) where the joints really are."""
        return self.joints.by_slot(np.array([servo.q for servo in self.servos]))


@pytest.fixture
def rig():
    return Rig().switch_on()


@given(WIRINGS, st.floats(-1.3, 1.3), st.integers(-3, 3))
def test_angles_are_read_on_whatever_turn_the_servo_was_switched_on(wiring, angle, turns):
    joints = Rig(TURRETS, wiring, turns_off=turns, position_rad=angle).joints
    half_a_tick = 0.5 * TICK_RAD / wiring[1]
    assert joints.angles[joints.has_servo] == pytest.approx(angle, abs=1.001 * half_a_tick)


@pytest.mark.slow
@settings(max_examples=5)
@given(WIRINGS)
def test_a_joint_turns_the_way_and_as_far_as_it_is_told(wiring):
    rig = Rig(TURRETS, wiring).switch_on()
    sent = rig.step(eyes(1.0, -0.5, 0.7, 0.2), count=30) + rig.step(np.zeros(7), count=30)
    # what a lag keeps back at the start it gives at the end
    expected = np.sum(sent, axis=0) * TURRETS.timing.period_s
    assert rig.true == pytest.approx(expected, abs=1e-3)
    assert rig.joints.angles == pytest.approx(rig.true, abs=TICK_RAD / wiring[1])


def test_measured_speeds_have_the_joints_sign():
    rig = Rig(TURRETS, (-1, 0.5, 100)).switch_on()
    rig.step(eyes(1.0, -1.0, 0.5, 0.25), count=20)
    assert rig.joints.speeds[3:] == pytest.approx([1.0, -1.0, 0.5, 0.25], abs=TICK_RAD_S / 0.5)


def test_what_is_rounded_off_is_carried_over(rig):
    told = TICK_RAD_S * eyes(0.3, -0.3, 1.7, -2.45)
    sent = np.array([rig.send(told)[1] for _ in range(200)])
    assert sent.mean(axis=0) == pytest.approx(told, abs=TICK_RAD_S / 200)


def test_zero_is_zero_at_once(rig):
    rig.send(TICK_RAD_S * eyes(0.4, 0.4, 0.4, 0.4))
    for _ in range(3):
        ticks, sent = rig.send(np.zeros(7))
        assert ticks == [0] * 4
        assert (sent == 0.0).all()


def test_a_servos_own_limit_bounds_what_is_sent():
    # a sync write beyond VELOCITY_LIMIT is dropped by the servo without a word
    rig = Rig()
    for servo in rig.servos:
        servo.set(table.VELOCITY_LIMIT, 100)
    rig.switch_on()
    for _ in range(2):
        ticks, sent = rig.send(eyes(5.0, -5.0, 5.0, -5.0))
        assert ticks == [100, -100, 100, -100]
        assert sent == pytest.approx(eyes(*ticks) * TICK_RAD_S)
    assert rig.send(np.zeros(7))[0] == [0] * 4


def test_tied_actuators_give_the_joints_angles_and_speeds():
    rig, actuation = Rig(ICUB).switch_on(), ICUB.actuation
    before = rig.joints.joint_angles_and_speeds()[0]
    assert before == pytest.approx(actuation.joints_of(np.zeros(7)), abs=2e-3)
    told = np.array([0.1, -0.1, 0.2, 0.1, 0.2, 0.3, 0.0])
    rig.step(told, count=40)
    q, v = rig.joints.joint_angles_and_speeds()
    assert q == pytest.approx(actuation.joints_of(rig.true), abs=2e-3)
    assert v == pytest.approx(actuation.joint_velocities_of(told), abs=2.0 * TICK_RAD_S)


def test_a_servo_that_misses_a_question_goes_on_as_it_went(rig):
    rig.step(eyes(1.0, 1.0, 1.0, 1.0), count=20)
    rig.servos[0].silent = True
    rig.clock.sleep(0.02)
    rig.sense()
    assert rig.joints.ages_s(rig.clock())[3:] == pytest.approx([0.02, 0.0, 0.0, 0.0])
    assert rig.joints.angles == pytest.approx(rig.true, abs=2e-3)


# ---- what is believed ----


@pytest.fixture
def joints():
    return JointAngles(robot_config(BusConfig(port="")).servos, TURRETS)


def told(time_s, angles, speeds=0.0, age_s=0.0):
    """A reading of four servos whose joints are at some angles, rad."""
    ticks = 2048 + np.rint(np.full(4, angles) / TICK_RAD)
    return ServoReading(time_s, ticks * TICK_RAD, np.zeros(4) + speeds, np.zeros(4) + age_s)


def test_an_angle_that_nobody_has_told_is_not_known(joints):
    joints.update(told(0.0, 0.1, age_s=[0.0, np.inf, np.inf, np.inf]))
    assert not joints.all_reported
    joints.update(told(0.1, 0.1))
    assert joints.all_reported
    assert joints.angles[3:] == pytest.approx(0.1, abs=TICK_RAD)


@pytest.mark.parametrize(("angle", "speed"), [(0.9, 0.0), (0.0, 20.0), (np.nan, 0.0)])
def test_what_no_joint_can_do_is_not_believed(joints, angle, speed):
    assert joints.update(told(0.0, 0.0)).all()
    wild = told(0.02, [0.01, angle, 0.01, 0.01], [0.0, speed, 0.0, 0.0])
    assert joints.update(wild).tolist() == [True, False, True, True]
    assert joints.angles[3:].max() < 0.02
    assert joints.ages_s(0.02).max() == 0.02


def test_a_joint_that_nobody_has_asked_for_long_may_be_anywhere(joints):
    joints.update(told(0.0, 0.0))
    assert joints.update(told(5.0, 1.2)).all()


def test_speeds_that_no_servo_reports_are_those_of_the_angles():
    joints = JointAngles(robot_config(BusConfig(port="")).servos, TURRETS, reports_speed=False)
    for k in range(40):
        missed = np.where((np.arange(4) == 1) & (k % 7 == 3), np.inf, 0.0)
        joints.update(told(k / 60.0, 0.5 * k / 60.0, np.nan, missed))
    assert joints.speeds[3:] == pytest.approx(0.5, abs=0.1)
    assert joints.angles[3:] == pytest.approx(0.5 * 39 / 60.0, abs=2e-3)


def test_a_reading_that_is_old_is_carried_on_at_its_speed(joints):
    joints.update(told(1.0, 0.2, 1.0, 0.03))
    assert joints.angles[3:] == pytest.approx(0.23, abs=1e-3)
    assert joints.ages_s(1.0)[3:] == pytest.approx(0.03)
