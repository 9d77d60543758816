"""Between joints and ticks: signs, zeros, gears, what is believed, and what is rounded off."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vergence import load_head
from vergence.hardware.config import ServoConfig, actuator_slots
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.emulator.servo import EmulatedServo
from vergence.hardware.emulator.world import ServoLine
from vergence.hardware.servo_angles import ServoAngles
from vergence.hardware.servo_memory import MOTION_SPAN

TURRETS, ICUB = load_head("turrets"), load_head("icub")
WIRINGS = st.tuples(st.sampled_from([1, -1]), st.sampled_from([0.5, 1.0]), st.integers(0, 4095))


def configs(head, sign=1, gear_ratio=1.0, zero_ticks=2048):
    lower, upper = 0.9 * head.actuation.lower, 0.9 * head.actuation.upper
    return tuple(
        ServoConfig(
            name=name, slot=slot, id=ident, zero_ticks=zero_ticks, sign=sign,
            gear_ratio=gear_ratio, lower_rad=float(lower[slot]), upper_rad=float(upper[slot]),
        )
        for ident, (name, slot) in enumerate(actuator_slots(head).items(), 1)
    )  # fmt: skip


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
        self.servos = ServoAngles(self.configs, head)
        self.servos.limit_ticks = {one.id: limit_ticks for one in self.configs}
        self.now = 0.0
        self.line.advance_to(0.0)
        self.sense()

    def sense(self):
        answers = {servo.id: servo.read(*MOTION_SPAN)[1] for servo in self.line.servos}
        self.servos.update(answers, self.now)

    def step(self, velocity):
        """One control period, as the plant makes it; what it says that it has sent."""
        ticks, sent = self.servos.velocities_to_ticks(velocity)
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
    sent = np.array([rig.servos.velocities_to_ticks(told)[1] for _ in range(200)])
    assert sent.mean(axis=0) == pytest.approx(told, abs=table.TICK_RAD_S / 200)


def test_zero_is_zero_at_once():
    rig = Rig(TURRETS)
    told = np.zeros(7)
    told[3:] = 0.4 * table.TICK_RAD_S
    rig.servos.velocities_to_ticks(told)
    for _ in range(3):
        ticks, sent = rig.servos.velocities_to_ticks(np.zeros(7))
        assert set(ticks.values()) == {0}
        assert (sent == 0.0).all()


def test_a_servos_own_limit_bounds_what_is_sent():
    # a sync write beyond VELOCITY_LIMIT is dropped by the servo without a word
    rig = Rig(TURRETS, limit_ticks=100)
    told = np.array([0.0, 0.0, 0.0, 5.0, -5.0, 5.0, -5.0])
    ticks, sent = rig.servos.velocities_to_ticks(told)
    assert list(ticks.values()) == [100, -100, 100, -100]
    assert sent[3:] == pytest.approx(np.array([1, -1, 1, -1]) * 100 * table.TICK_RAD_S)
    rig.servos.velocities_to_ticks(told)
    ticks, _sent = rig.servos.velocities_to_ticks(np.zeros(7))
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
    answers = {one.id: one.read(*MOTION_SPAN)[1] for one in rig.line.servos[1:]}
    rig.servos.update(answers, rig.now)
    assert rig.servos.angles == pytest.approx(rig.true, abs=2e-3)


def test_an_angle_that_nobody_has_told_is_not_known():
    servos = ServoAngles(configs(TURRETS), TURRETS)
    rig = Rig(TURRETS)
    answers = {one.id: one.read(*MOTION_SPAN)[1] for one in rig.line.servos}
    servos.update({1: answers[1]}, 0.0)
    assert not servos.all_reported
    servos.update(answers, 0.1)
    assert servos.all_reported
    assert np.isfinite(servos.angles).all()


def answer(angle, speed=0.0):
    speed_ticks, ticks = round(speed / table.TICK_RAD_S), 2048 + round(angle / table.TICK_RAD)
    return speed_ticks.to_bytes(4, "little", signed=True) + ticks.to_bytes(4, "little", signed=True)


@pytest.mark.parametrize("wild", [answer(0.9), answer(0.0, 20.0)])
def test_what_no_joint_can_do_is_not_believed(wild):
    servos = ServoAngles(configs(TURRETS), TURRETS)
    assert servos.update({i: answer(0.0) for i in range(1, 5)}, 0.0) == {1, 2, 3, 4}
    assert servos.update({**{i: answer(0.01) for i in range(1, 5)}, 2: wild}, 0.02) == {1, 3, 4}
    assert servos.angles[servos.has_servo].max() < 0.02
    assert servos.reading_ages_s(0.02).max() == 0.02


def test_a_joint_that_nobody_has_asked_for_long_may_be_anywhere():
    servos = ServoAngles(configs(TURRETS), TURRETS)
    servos.update({i: answer(0.0) for i in range(1, 5)}, 0.0)
    assert servos.update({i: answer(1.2) for i in range(1, 5)}, 5.0) == {1, 2, 3, 4}
