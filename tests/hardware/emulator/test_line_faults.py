"""Faults of the line: what is sent in place of servos' answers, and when."""

import numpy as np

from vergence.hardware.dynamixel.packets import PacketParser, status_packet
from vergence.hardware.emulator.faults import parse_fault
from vergence.hardware.emulator.world import TimedAnswer, apply_line_faults

ANSWERS = [TimedAnswer(id, 0.0, status_packet(id, b"abcd")) for id in (1, 2, 3)]


def sent(*faults, seed=0):
    made = [parse_fault(fault, (1, 2, 3), timed=False) for fault in faults]
    return apply_line_faults(ANSWERS, made, np.random.default_rng(seed))


def heard(data):
    return [packet.id for packet in PacketParser().feed(data)]


def test_without_faults_all_goes_out_in_one_piece():
    assert sent() == [(0.0, b"".join(answer.data for answer in ANSWERS))]


def test_a_fault_meets_the_answer_of_its_servo_alone():
    without, twice = [1, 3], [1, 2, 2, 3]
    for what, ids in (
        ("bad-crc", without), ("short", without), ("lost", without), ("doubled", twice),
    ):  # fmt: skip
        ((late_s, data),) = sent({"what": what, "ids": [2]})
        assert late_s == 0.0
        assert heard(data) == ids, what


def test_a_late_answer_holds_up_no_other():
    on_time, late = sent({"what": "late", "ids": [1], "value": 0.02})
    assert (on_time[0], heard(on_time[1])) == (0.0, [2, 3])
    assert (late[0], heard(late[1])) == (0.02, [1])
    assert [late_s for late_s, _ in sent({"what": "late"})] == [0.012]


def test_each_answer_is_met_with_the_faults_probability():
    fault = {"what": "lost", "probability": 0.25}
    answers = sum(len(heard(b"".join(data for _, data in sent(fault, seed=i)))) for i in range(400))
    # 1200 draws: 900 expected, with a standard deviation of 15
    assert 840 < answers < 960


def test_all_may_be_lost():
    assert sent({"what": "lost"}) == []
