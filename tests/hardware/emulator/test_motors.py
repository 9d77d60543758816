"""Imperfect motors of an emulated head: latency, reduced strength, backlash."""

import numpy as np
import pytest

from tests.hardware.emulator.served import POINT
from vergence import load_head
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.packets import BROADCAST, Instruction, Packet
from vergence.hardware.emulator.world import MotorOptions, World

HEAD = load_head("turrets")
TICKS = 40
LATENCY_S = 0.015


def turn(world, ticks, now_s):
    """Tell the first servo a velocity, as the plant does."""
    register = table.GOAL_VELOCITY
    place = [*register.address.to_bytes(2, "little"), *register.length.to_bytes(2, "little")]
    data = bytes([*place, 1, *ticks.to_bytes(4, "little", signed=True)])
    world.answer(Packet(BROADCAST, Instruction.SYNC_WRITE, data), now_s, 1_000_000)


def made(**motors):
    world = World(HEAD, POINT, MotorOptions(**motors))
    world.advance_to(0.0)
    for servo in world.line.servos:
        servo.set(table.OPERATING_MODE, table.VELOCITY_MODE)
        servo.set(table.TORQUE_ENABLE, 1)
    return world


@pytest.fixture
def world():
    return made(
        lag_s=0.02, speed_gain=0.5, command_latency_s=LATENCY_S, backlash_rad=0.01,
        acceleration_rad_s2=1000.0,
    )  # fmt: skip


def test_a_command_acts_when_its_latency_has_passed(world):
    turn(world, TICKS, 0.1)
    assert world.state(0.1 + LATENCY_S)["velocities"][3] == 0.0
    speed = 0.5 * TICKS * table.TICK_RAD_S
    after = world.state(0.1 + LATENCY_S + 0.02)["velocities"][3]
    assert after == pytest.approx(speed * (1.0 - np.exp(-1.0)), rel=1e-3)


def test_what_servos_report_is_as_old_as_their_feedback():
    late_s = 0.0125
    now, late = made(), made(feedback_latency_s=late_s)
    for world in (now, late):
        turn(world, TICKS, 0.1)

    def reported(world, at_s):
        world.advance_to(at_s)
        servo = world.line.servos[0]
        servo.read(table.PRESENT_POSITION.address, table.PRESENT_POSITION.length)
        return servo.get(table.PRESENT_POSITION), servo.get(table.PRESENT_VELOCITY)

    for at_s in (0.1, 0.13, 0.2, 1.0):  # at rest, gathering speed, steady
        assert reported(late, at_s + late_s) == pytest.approx(reported(now, at_s), abs=1)
    assert late.state(1.1)["positions"] == pytest.approx(now.state(1.1)["positions"])


def test_play_lets_the_camera_stay_behind_and_the_encoder_sees_none(world):
    turn(world, TICKS, 0.1)
    ahead = world.state(1.0)
    assert ahead["motors"][3] - ahead["positions"][3] == pytest.approx(0.005)
    turn(world, -TICKS, 1.0)
    back = world.state(2.0)
    assert back["motors"][3] - back["positions"][3] == pytest.approx(-0.005)
