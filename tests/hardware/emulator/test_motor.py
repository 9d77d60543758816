"""The motor's own loop: friction, a blind encoder, an inverted motor, a profile."""

import pytest

from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.emulator.servo import EmulatedServo

ACCELERATION, LAG_S = 80.0, 0.03


def turning(speed_rad_s=0.0, **options):
    servo = EmulatedServo(1, lag_s=LAG_S, acceleration=ACCELERATION, max_speed=6.0, **options)
    servo.advance_to(0.0)
    servo.set(table.OPERATING_MODE, table.VELOCITY_MODE)
    servo.set(table.TORQUE_ENABLE, 1)
    ask(servo, speed_rad_s)
    return servo


def ask(servo, speed_rad_s):
    servo.set(table.GOAL_VELOCITY, round(speed_rad_s / table.TICK_RAD_S))


def test_without_friction_the_loop_answers_as_the_joint_law():
    law, own = turning(1.0), turning(1.0, gravity=1e-9)
    for time_s in (0.02, 0.05, 0.1, 0.3):
        law.advance_to(time_s)
        own.advance_to(time_s)
        # half a step of a Euler integration
        assert own.q == pytest.approx(law.q, abs=1.0 * 5e-4)


def test_friction_holds_a_joint_until_the_integral_breaks_it_away():
    servo = turning(0.1, friction=0.08)
    servo.advance_to(0.02)
    assert servo.q == 0.0
    servo.advance_to(1.0)
    assert servo.v == pytest.approx(servo.get(table.GOAL_VELOCITY) * table.TICK_RAD_S, rel=0.02)


def test_gravity_turns_a_joint_without_torque():
    servo = turning(gravity=0.1)
    servo.advance_to(0.5)
    held = abs(servo.q)
    servo.set(table.TORQUE_ENABLE, 0)
    servo.advance_to(1.0)
    assert held < 0.02
    assert servo.q < -0.05


def test_a_blind_loop_turns_on_at_a_goal_of_zero_until_it_has_no_torque():
    servo = turning(2.0)
    servo.advance_to(0.2)
    servo.frozen = servo.blind = True
    servo.advance_to(0.4)
    ask(servo, 0.0)
    servo.advance_to(2.0)
    assert servo.v > 1.0
    servo._report()
    assert servo.get(table.PRESENT_VELOCITY) == 0
    servo.set(table.TORQUE_ENABLE, 0)
    servo.advance_to(2.5)
    assert servo.v < table.TICK_RAD_S


def test_an_inverted_motor_runs_away_against_its_goal():
    servo = turning(0.2)
    servo.inverted = True
    servo.advance_to(0.5)
    assert servo.v < -5.0


def test_a_profile_limits_the_acceleration_in_velocity_mode():
    servo = turning(3.0)
    servo.set(table.PROFILE_ACCELERATION, 10)  # 3.745 rad/s^2
    servo.advance_to(0.5)
    assert servo.v == pytest.approx(3.745 * (0.5 - LAG_S), rel=0.01)
