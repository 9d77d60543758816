"""Questions to a line of emulated servos, in time that the test sets."""

import numpy as np

from tests.hardware.line import make_servo
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.packets import Instruction, PacketParser, instruction_packet
from vergence.hardware.emulator.world import ServoLine


def ask(line, now_s, sent):
    """The statuses that a packet brings about."""
    (packet,) = PacketParser().feed(sent)
    sent = b"".join(answer.data for answer in line.answer(packet, now_s))
    return [packet.status for packet in PacketParser().feed(sent)]


def write(line, now_s, id, register, value):
    params = register.address.to_bytes(2, "little") + register.encode(value)
    return ask(line, now_s, instruction_packet(id, Instruction.WRITE, params))


def read(line, now_s, id, register):
    params = register.address.to_bytes(2, "little") + register.length.to_bytes(2, "little")
    (status,) = ask(line, now_s, instruction_packet(id, Instruction.READ, params))
    return register.decode(status.data)


def turning(goal=100, mode=table.VELOCITY_MODE, **options):
    """A line of one servo with torque on since 0 s."""
    line = ServoLine([make_servo(1, **options)])
    write(line, 0.0, 1, table.OPERATING_MODE, mode)
    write(line, 0.0, 1, table.TORQUE_ENABLE, 1)
    write(line, 0.0, 1, table.GOAL_VELOCITY, goal)
    return line


POINT = np.array([0.0, -0.1, 1.0])
