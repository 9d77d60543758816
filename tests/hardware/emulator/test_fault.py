"""Faults as people write them: what is refused, and what is taken for granted."""

import math

import pytest

from tests.commands.test_failures import call
from tests.naming import named
from vergence.errors import HeadFileError
from vergence.hardware.emulator.faults import load_faults, parse_fault

IDS = (1, 2, 3, 4)


def parsed(**values):
    return parse_fault(values, IDS, timed=False)


def test_a_fault_is_of_all_servos_for_good_unless_told_otherwise():
    fault = parsed(what="lost")
    assert (fault.place, fault.ids, fault.probability) == ("line", IDS, 1.0)
    assert math.isinf(fault.for_s)


def test_an_eye_makes_it_a_fault_of_a_camera():
    assert parsed(what="late").place == "line"
    assert parsed(what="late", eye="left").place == "camera"
    assert parsed(what="frozen").place == "servo"
    torn, left = parsed(what="torn"), parsed(what="torn", eye="left")
    assert [torn.affects(0), torn.affects(1), left.affects(1)] == [True, True, False]


def test_what_is_no_fault_is_refused_with_what_there_is():
    for values, said in (
        ({}, r"fault\.what: expected one of bad-crc, .*out-of-step"),
        ({"what": "losst"}, r"fault\.what: expected one of bad-crc, .*, got 'losst'"),
        ({"what": "lost", "id": 1}, r"fault\.id: .* lost takes: what, ids, for_s, probability"),
        ({"what": "lost", "ids": [9]}, r"fault\.ids: .* of 1, 2, 3, 4, got \[9\]"),
        ({"what": "lost", "ids": []}, r"fault\.ids: "),
        ({"what": "lost", "ids": [True]}, r"fault\.ids: "),
        ({"what": "lost", "probability": 0.0}, r"fault\.probability: "),
        ({"what": "lost", "for_s": float("nan")}, r"fault\.for_s: "),
        ({"what": "late", "value": -1.0}, r"fault\.value: expected seconds"),
        ({"what": "late", "eye": "middle"}, r"fault\.eye: expected one of left, right, both"),
        ({"what": "late", "eye": "left", "ids": [1]}, r"fault\.ids: .* what, eye, for_s, value"),
        ({"what": "voltage"}, r"fault\.value: expected V"),
        ({"what": "lost", "at_s": 1.0}, r"fault\.at_s: "), (5, "fault: expected a table"),
    ):  # fmt: skip
        with named(values), pytest.raises(HeadFileError, match=said):
            parse_fault(values, IDS, timed=False)


def test_a_script_says_when_faults_begin(tmp_path):
    path = tmp_path / "faults.toml"
    first, second = 'what = "lost"\nat_s = 2\nids = [3]', 'what = "unplug"\nat_s = 5'
    path.write_text(f"[[fault]]\n{first}\n[[fault]]\n{second}")
    assert [(one.what, one.at_s) for one in load_faults(path, IDS)] == [("lost", 2), ("unplug", 5)]


def test_a_wrong_script_is_refused_in_a_line_before_anything_starts(capsys, tmp_path):
    path = tmp_path / "faults.toml"
    for text, said in (
        ("[[fault", "no TOML"), ("", "fault: expected tables"),
        ('[[fault]]\nwhat = "lost"', "fault[0].at_s: expected seconds since torque"),
        ('[[fault]]\nwhat = "lost"\nat_s = 1\nids = [9]', "fault[0].ids: "),
        ('[[faults]]\nwhat = "lost"\nat_s = 1', "is it meant by faults?"),
    ):  # fmt: skip
        path.write_text(text)
        with named(text):
            assert call("emulate", "--faults", str(path)) == 2
            (line,) = capsys.readouterr().err.splitlines()
            assert said in line
            assert str(path) in line
