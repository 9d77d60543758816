"""The failures that docs/robot.md lists have the messages that it lists."""

import errno
import os
import re
from pathlib import Path

import pytest

from tests.hardware.desk import desk_config, ready_servos
from tests.hardware.test_check_cameras import Desk
from vergence.errors import ChecksFailedError
from vergence.hardware.checks import check_servos
from vergence.hardware.config import BusConfig
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.bus import Bus
from vergence.hardware.line_checks import open_bus

PORT = "/dev/ttyUSB0"
DOC = Path(__file__).resolve().parents[2] / "docs" / "robot.md"
LISTED = dict(
    re.findall(r"<!-- message ([a-z-]+) -->\n```\n(.*?)\n```", DOC.read_text("utf-8"), re.DOTALL)
)


def all_of(**registers):
    """Servos of which the second has other numbers in its registers."""
    servos = ready_servos()
    for name, value in registers.items():
        servos[1].set(getattr(table, name), value)
    return servos


def turned():
    """Servos of which the second has been turned to 1.6 rad."""
    servos = ready_servos()
    servos[1].q = 1.6
    return servos


SERVOS = {
    "no-answer": list,
    "missing-id": lambda: ready_servos()[:3],
    "voltage": lambda: all_of(PRESENT_INPUT_VOLTAGE=58),
    "overload": lambda: all_of(HARDWARE_ERROR_STATUS=0b100000),
    "homing-offset": lambda: all_of(HOMING_OFFSET=1024),
    "wrapped-angle": turned,
}


@pytest.mark.parametrize("name", SERVOS)
def test_the_line_of_a_servo(serve, name):
    served = serve(SERVOS[name]())
    bus = Bus(served.port, single_timeout_s=0.01)
    found = check_servos(desk_config(served.port), bus)
    bus.close()
    assert str(found[0]).replace(served.port, PORT) == LISTED[name]


def test_the_line_of_a_port_without_permission(monkeypatch, tmp_path):
    port = tmp_path / "ttyUSB0"
    port.touch()

    def refuse(*_words):
        raise PermissionError(errno.EACCES, "no")

    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(ChecksFailedError) as failed:
        open_bus(BusConfig(port=str(port)))
    assert str(failed.value).replace(str(port), PORT) == LISTED["permission"]


CAMERAS = {
    "camera-time-out": (Desk(at0={"rate_hz": 0.0}, at2={"rate_hz": 30.0}), {}),
    "camera-bandwidth": (Desk(40.0, at0={"rate_hz": 30.0}, at2={"rate_hz": 30.0}), {}),
    "camera-setting": (
        Desk(at0={"rate_hz": 30.0, "pixel_format": "YUYV"}, at2={"rate_hz": 30.0}),
        {"pixel_format": "MJPG"},
    ),
}


@pytest.mark.parametrize("name", CAMERAS)
def test_the_line_of_a_camera(name):
    desk, asked = CAMERAS[name]
    _states, findings = desk.check(**asked)
    assert LISTED[name] in [str(finding) for finding in findings]


def test_each_message_that_is_listed_is_compared():
    assert set(LISTED) == {*SERVOS, *CAMERAS, "permission"}
