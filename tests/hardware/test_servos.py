"""Between joints and ticks: signs, zeros, gears, what is believed, and what is rounded off."""

from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vergence import load_head
from vergence.hardware.config import actuator_slots
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.servos import DynamixelServos
from vergence.hardware.emulator.servo import EmulatedServo
from vergence.hardware.emulator.world import ServoLine
from vergence.hardware.servos import JointAngles, ServoConfig, ServoReading

TURRETS, ICUB = load_head("turrets"), load_head("icub")
WIRINGS = st.tuples(st.sampled_from([1, -1]), st.sampled_from([0.5, 1.0]), st.integers(0, 4095))


def configs(head, sign=1, gear_ratio=1.0, zero_ticks=2048):
    lower, upper = 0.9 * head.actuation.lower, 0.9 * head.actuation.upper
    return tuple(
        ServoConfig(
            name=name, slot=slot, id=ident, zero=zero_ticks, unit_rad=table.TICK_RAD, sign=sign,
            gear_ratio=gear_ratio, lower_rad=float(lower[slot]), upper_rad=float(upper[slot]),
        )
        for ident, (name, slot) in enumerate(actuator_slots(head).items(), 1)
    )  # fmt: skip


def reading(servos, time_s, silent=()):
    """What a bus reads of emulated servos."""
    told = [one.read(*table.MOTION_SPAN)[1] for one in servos]
    ticks = [
        [table.PRESENT_POSITION.decode(data[4:]) for data in told],
        [table.PRESENT_VELOCITY.decode(data[:4]) for data in told],
    ]
    ages_s = np.where(np.isin(np.arange(len(servos)), silent), np.inf, 0.0)
    units = np.array([[table.TICK_RAD], [table.TICK_RAD_S]])
    return ServoReading(time_s, *(np.array(ticks) * units), ages_s)


class Rig:
    """Emulated servos and the plant's own view of them, in simulated time."""

    def __init__(self, head, wiring=(1, 1.0, 2048), turns_off=0, limit_ticks=265, **options):
        sign, gear_ratio, zero_ticks = wiring
        self.head = head
        self.configs = configs(head, sign, gear_ratio, zero_ticks)
        self.line = ServoLine(
            EmulatedServo(
                one.id, lag_s=float(head.timing.lag_s * head.actuation.lag_ratio[one.slot]),
                acceleration=float(head.actuation.acceleration[one.slot]), sign=sign,
                gear_ratio=gear_ratio, zero_ticks=zero_ticks + turns_off * table.TICKS_PER_TURN,
                **options,
            )
            for one in self.configs
        )  # fmt: skip
        for servo in self.line.servos:
            servo.write(table.OPERATING_MODE.address, bytes([table.VELOCITY_MODE]))
            servo.write(table.TORQUE_ENABLE.address, b"\1")
        self.servos = JointAngles(self.configs, head)
        self.bus, self.sent = DynamixelServos(self.configs, head, port=""), {}
        self.bus._line = Mock(sync_write=lambda register, values: self.sent.update(values))
        self.bus._limit_ticks[:], self.bus._torque[:] = limit_ticks, True
        self.now = 0.0
        self.line.advance_to(0.0)
        self.sense()

    def sense(self):
        self.servos.update(reading(self.line.servos, self.now))

    def send(self, velocity):
        """What the servos get, in ticks, and what it says that it has sent."""
        sent = self.servos.velocities(self.bus.send(self.servos.shaft_speeds(velocity)))
        return self.sent, sent

    def step(self, velocity):
        """One control period, as the plant makes it; what it says that it has sent."""
        ticks, sent = self.send(velocity)
        for servo in self.line.servos:
            goal = table.GOAL_VELOCITY
            assert servo.write(goal.address, goal.encode(ticks[servo.id])) == 0
        self.now += self.head.timing.period_s
        self.line.advance_to(self.now)
        self.sense()
        return sent

    @property
    def true(self):
        """(7,) where the joints really are."""
        q = np.zeros(7)
        for one, servo in zip(self.configs, self.line.servos, strict=True):
            q[one.slot] = servo.q
        return q


@given(WIRINGS, st.floats(-1.3, 1.3), st.integers(-3, 3))
def test_angles_are_read_on_whatever_turn_the_servo_was_switched_on(wiring, angle, turns):
    rig = Rig(TURRETS, wiring, turns_off=turns, position_rad=angle)
    half_a_tick = 0.5 * table.TICK_RAD / wiring[1]
    there = rig.servos.has_servo
    assert rig.servos.angles[there] == pytest.approx(angle, abs=1.001 * half_a_tick)


@pytest.mark.slow
@settings(max_examples=5)
@given(WIRINGS)
def test_a_joint_turns_the_way_and_as_far_as_it_is_told(wiring):
    rig = Rig(TURRETS, wiring)
    told = np.array([0.0, 0.0, 0.0, 1.0, -0.5, 0.7, 0.2])
    sent = [rig.step(told) for _ in range(30)]
    sent += [rig.step(np.zeros(7)) for _ in range(30)]
    # what a lag keeps back at the start it gives at the end
    expected = np.sum(sent, axis=0) * TURRETS.timing.period_s
    assert rig.true == pytest.approx(expected, abs=1e-3)
    assert rig.servos.angles == pytest.approx(rig.true, abs=table.TICK_RAD / wiring[1])


def test_measured_speeds_have_the_joints_sign():
    rig = Rig(TURRETS, (-1, 0.5, 100))
    for _ in range(20):
        rig.step(np.array([0.0, 0.0, 0.0, 1.0, -1.0, 0.5, 0.25]))
    measured = rig.servos.speeds[rig.servos.has_servo]
    assert measured == pytest.approx([1.0, -1.0, 0.5, 0.25], abs=table.TICK_RAD_S / 0.5)


def test_what_is_rounded_off_is_carried_over():
    rig = Rig(TURRETS)
    told = np.zeros(7)
    told[3:] = np.array([0.3, -0.3, 1.7, -2.45]) * table.TICK_RAD_S
    sent = np.array([rig.send(told)[1] for _ in range(200)])
    assert sent.mean(axis=0) == pytest.approx(told, abs=table.TICK_RAD_S / 200)


def test_zero_is_zero_at_once():
    rig = Rig(TURRETS)
    told = np.zeros(7)
    told[3:] = 0.4 * table.TICK_RAD_S
    rig.send(told)
    for _ in range(3):
        ticks, sent = rig.send(np.zeros(7))
        assert set(ticks.values()) == {0}
        assert (sent == 0.0).all()


def test_a_servos_own_limit_bounds_what_is_sent():
    # a sync write beyond VELOCITY_LIMIT is dropped by the servo without a word
    rig = Rig(TURRETS, limit_ticks=100)
    told = np.array([0.0, 0.0, 0.0, 5.0, -5.0, 5.0, -5.0])
    ticks, sent = rig.send(told)
    assert list(ticks.values()) == [100, -100, 100, -100]
    assert sent[3:] == pytest.approx(np.array([1, -1, 1, -1]) * 100 * table.TICK_RAD_S)
    rig.send(told)
    ticks, _sent = rig.send(np.zeros(7))
    assert set(ticks.values()) == {0}


def test_tied_actuators_give_the_joints_angles_and_speeds():
    rig = Rig(ICUB)
    told = np.array([0.1, -0.1, 0.2, 0.1, 0.2, 0.3, 0.0])
    before = rig.servos.joint_angles_and_speeds()[0]
    for _ in range(40):
        rig.step(told)
    q, v = rig.servos.joint_angles_and_speeds()
    assert q == pytest.approx(ICUB.actuation.joints_of(rig.true), abs=2e-3)
    assert v == pytest.approx(ICUB.actuation.joint_velocities_of(told), abs=2.0 * table.TICK_RAD_S)
    assert before == pytest.approx(ICUB.actuation.joints_of(np.zeros(7)), abs=2e-3)


def test_a_servo_that_misses_a_question_goes_on_as_it_went():
    rig = Rig(TURRETS)
    for _ in range(20):
        rig.step(np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0]))
    rig.now += 0.02
    rig.line.advance_to(rig.now)
    rig.servos.update(reading(rig.line.servos, rig.now, silent=(0,)))
    assert rig.servos.angles == pytest.approx(rig.true, abs=2e-3)


def test_an_angle_that_nobody_has_told_is_not_known():
    servos = JointAngles(configs(TURRETS), TURRETS)
    rig = Rig(TURRETS)
    servos.update(reading(rig.line.servos, 0.0, silent=(1, 2, 3)))
    assert not servos.all_reported
    servos.update(reading(rig.line.servos, 0.1))
    assert servos.all_reported
    assert np.isfinite(servos.angles).all()


def told(time_s, angles, speeds=0.0, age_s=0.0):
    """A reading of four servos whose joints are at some angles, rad."""
    ticks = 2048 + np.rint(np.full(4, angles) / table.TICK_RAD)
    return ServoReading(time_s, ticks * table.TICK_RAD, np.zeros(4) + speeds, np.zeros(4) + age_s)


@pytest.mark.parametrize(("angle", "speed"), [(0.9, 0.0), (0.0, 20.0), (np.nan, 0.0)])
def test_what_no_joint_can_do_is_not_believed(angle, speed):
    servos = JointAngles(configs(TURRETS), TURRETS)
    assert servos.update(told(0.0, 0.0)).all()
    wild = told(0.02, [0.01, angle, 0.01, 0.01], [0.0, speed, 0.0, 0.0])
    assert servos.update(wild).tolist() == [True, False, True, True]
    assert servos.angles[servos.has_servo].max() < 0.02
    assert servos.ages_s(0.02).max() == 0.02


def test_a_joint_that_nobody_has_asked_for_long_may_be_anywhere():
    servos = JointAngles(configs(TURRETS), TURRETS)
    servos.update(told(0.0, 0.0))
    assert servos.update(told(5.0, 1.2)).all()


def test_speeds_that_no_servo_reports_are_those_of_the_angles():
    servos = JointAngles(configs(TURRETS), TURRETS, reports_speed=False)
    for k in range(40):
        missed = np.where((np.arange(4) == 1) & (k % 7 == 3), np.inf, 0.0)
        servos.update(told(k / 60.0, 0.5 * k / 60.0, np.nan, missed))
    assert servos.speeds[servos.has_servo] == pytest.approx(0.5, abs=0.1)
    assert servos.angles[servos.has_servo] == pytest.approx(0.5 * 39 / 60.0, abs=2e-3)


def test_a_reading_that_is_old_is_carried_on_at_its_speed():
    servos = JointAngles(configs(TURRETS), TURRETS)
    servos.update(told(1.0, 0.2, 1.0, 0.03))
    assert servos.angles[servos.has_servo] == pytest.approx(0.23, abs=1e-3)
    assert servos.ages_s(1.0)[3:] == pytest.approx(0.03)
