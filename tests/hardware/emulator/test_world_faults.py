"""Faults of an emulated head's world: when they begin and end, and what its clients are told."""

import numpy as np
import pytest

from tests.hardware.emulator.served import POINT
from tests.naming import named
from vergence import load_head
from vergence.errors import HardwareError
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.packets import BROADCAST, Instruction, Packet
from vergence.hardware.emulator.faults import parse_fault
from vergence.hardware.emulator.world import World

RATE = 1_000_000


class Head:
    """A world whose servos are in velocity mode, in time that the test sets."""

    def __init__(self, torque=1, script=()):
        self.world = World(load_head("turrets"), POINT)
        self.world.faults.schedule(self.fault(**one) for one in script)
        self.write(0.0, table.OPERATING_MODE, table.VELOCITY_MODE)
        self.write(0.0, table.TORQUE_ENABLE, torque)

    def fault(self, **values):
        return parse_fault(values, self.world.ids, timed="at_s" in values)

    def begin(self, now_s, **values):
        self.world.begin_fault(self.fault(**values), now_s)

    def write(self, now_s, register, value):
        data = register.encode(value)
        params = register.address.to_bytes(2, "little") + len(data).to_bytes(2, "little")
        params += b"".join(bytes((id,)) + data for id in self.world.ids)
        self.world.answer(Packet(BROADCAST, Instruction.SYNC_WRITE, params), now_s, RATE)

    def pings(self, now_s, rate=RATE):
        return self.world.answer(Packet(BROADCAST, Instruction.PING, b""), now_s, rate)

    def get(self, now_s, register, name="left_pan"):
        self.world.advance_to(now_s)
        return self.world.servos[name].get(register)

    @property
    def speeds(self):
        return self.world.line.velocities()


def test_return_delays_add_up_on_the_line():
    head = Head()
    for servo in head.world.line.servos:
        servo.set(table.RETURN_DELAY_TIME, 250)
    assert [delay_s for delay_s, _ in head.pings(0.0)] == [pytest.approx(4 * 500e-6)]


def test_a_fault_ends_at_its_own_instant():
    late, prompt = Head(), Head()
    for head in (late, prompt):
        head.begin(1.0, what="stuck", ids=[1], for_s=0.5)
        head.write(1.0, table.GOAL_VELOCITY, 20)
    late.world.advance_to(2.0)  # in one go, past the end
    prompt.world.advance_to(1.5)
    assert prompt.speeds[0] == 0.0
    assert prompt.speeds[1] > 0.1
    prompt.world.advance_to(2.0)
    assert late.world.line.positions() == pytest.approx(prompt.world.line.positions())
    assert late.speeds[0] > 0.1


def test_what_a_servo_measures_is_well_again_after_the_fault():
    head = Head()
    head.begin(0.0, what="voltage", ids=[1], value=10.5, for_s=1.0)
    head.begin(0.0, what="load", ids=[1], value=-45.0, for_s=1.0)
    head.begin(0.0, what="temperature", ids=[1], value=60, for_s=1.0)
    asked = (table.PRESENT_INPUT_VOLTAGE, table.PRESENT_LOAD, table.PRESENT_TEMPERATURE)
    assert [head.get(0.5, register) for register in asked] == [105, -450, 60]
    assert [head.get(1.5, register) for register in asked] == [120, 0, 31]


def test_a_servo_that_shuts_down_or_reboots_lets_go_at_that_instant():
    for fault in ({"what": "overload"}, {"what": "temperature", "value": 90}, {"what": "reboot"}):
        head = Head()
        head.write(0.0, table.GOAL_VELOCITY, 20)
        head.begin(0.5, ids=[1], **fault)
        with named(fault):
            assert [one.get(table.TORQUE_ENABLE) for one in head.world.line.servos] == [0, 1, 1, 1]
            head.world.advance_to(2.0)
            assert head.speeds[0] == pytest.approx(0.0, abs=1e-6)
            assert head.speeds[1] > 0.1


def test_a_silent_servo_does_not_answer_until_it_is_cleared():
    head = Head()
    (_, all_four), *_ = head.pings(0.0)
    head.begin(0.0, what="silent", ids=[3])
    (_, three), *_ = head.pings(0.1)
    assert len(three) == 0.75 * len(all_four)
    head.world.clear_faults(0.2)
    assert head.pings(0.2) == [(0.0, all_four)]


def test_a_script_counts_from_the_torque_on():
    head = Head(torque=0, script=[{"what": "stuck", "at_s": 1.0, "for_s": 0.5}])
    head.world.advance_to(5.0)
    head.write(5.0, table.TORQUE_ENABLE, 1)
    head.write(5.0, table.GOAL_VELOCITY, 20)
    stuck = []
    for now_s in (5.9, 6.1, 6.6):
        head.world.advance_to(now_s)
        stuck.append(head.world.servos["left_pan"].stuck)
    assert stuck == [False, True, False]


def test_a_client_is_told_when_its_fault_began(served):
    served.clock.now = 120.0
    assert served.client.begin_fault(what="stuck", ids=[1], for_s=0.4) == 120.0
    with pytest.raises(HardwareError, match=r"^emulator: fault\.what: expected one of bad-crc, "):
        served.client.begin_fault(what="broken")


def test_cameras_learn_of_their_faults_with_the_next_exposure_until_they_are_cleared(served):
    served.client.begin_fault(what="late", eye="right", value=0.5)
    served.client.begin_fault(what="stuck")
    exposure = served.client.ask({"expose": None})
    assert exposure["faults"] == [{"what": "late", "eye": "right", "value": 0.5}]
    served.client.clear_faults()
    assert served.client.ask({"expose": None})["faults"] == []


def test_a_client_is_told_from_when_on_the_joints_rest(served):
    start_s = served.clock.now
    for servo in served.world.line.servos:
        servo.write(table.OPERATING_MODE.address, b"\1")
        servo.write(table.TORQUE_ENABLE.address, b"\1")
    served.client.ask({"state": None})
    served.world.servos["left_pan"].set(table.GOAL_VELOCITY, 50)
    served.clock.sleep(0.3)
    assert served.client.rest_start_s(start_s) is None
    began_s = served.client.begin_fault(what="overload", ids=[1])
    served.clock.sleep(1.0)
    rested_s = served.client.rest_start_s(began_s)
    assert began_s + 0.03 < rested_s < began_s + 0.5
    assert served.client.ask({"rest": {"since": began_s}})["fastest"] > 1.0


def test_the_record_has_each_joint_since_the_last_call(served):
    served.client.ask({"record": None})
    started_s = served.clock.now
    servo = served.world.servos["left_pan"]
    servo.write(table.OPERATING_MODE.address, b"\1")
    servo.write(table.TORQUE_ENABLE.address, b"\1")
    servo.set(table.GOAL_VELOCITY, 50)
    served.clock.sleep(0.1)
    record = served.client.ask({"record": None})["left_pan"]
    assert record["times"][0] == started_s
    assert np.diff(record["times"]).max() <= 0.002 + 1e-9
    assert record["velocities"][-1] == pytest.approx(servo.v)
    assert record["positions"][-1] == pytest.approx(servo.q)
