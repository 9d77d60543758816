"""The failures that docs/robot.md lists have the messages that it lists."""

import errno
import os
import re
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests.hardware.fakes import HEAD
from tests.hardware.line import desk_config, make_servo, open_briefly, ready_servos
from tests.hardware.test_camera_checks import Desk
from tests.hardware.virtual import PORT as VIRTUAL_PORT
from tests.hardware.virtual import VirtualRobot
from tests.naming import named
from vergence.errors import ChecksFailedError
from vergence.hardware.checks import CameraRequest, check_cameras, check_servos
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.checks import open_bus
from vergence.hardware.emulator.config import EmulatorConfig
from vergence.hardware.emulator.world import World
from vergence.vision import image

PORT = "/dev/ttyUSB0"
FACTORY_RATE = table.BAUD_RATES.index(57_600)
DOC = Path(__file__).resolve().parents[2] / "docs" / "robot.md"
LISTED = dict(
    re.findall(r"<!-- message ([a-z-]+) -->\n```\n(.*?)\n```", DOC.read_text("utf-8"), re.DOTALL)
)


def desk(places=(1,), **registers):
    """Servos of which some, by default the second, have other numbers in their registers."""
    servos = ready_servos()
    for place in places:
        for name, value in registers.items():
            servos[place].set(getattr(table, name), value)
    return servos


def at(angle_rad, place=1, more=()):
    """Servos, and maybe more of them, of which one has been turned."""
    servos = [*ready_servos(), *more]
    servos[place].q = angle_rad
    return servos


def collide(_packet, answers):
    """The answers of servos that talk at once: their checksums are wrong."""
    return answers[:-1] + bytes(byte ^ 0xFF for byte in answers[-1:])


SERVOS = {
    "no-answer": (list, {}), "missing-id": (lambda: ready_servos()[:3], {}),
    "equal-ids": (lambda: at(0.3, -1, [make_servo(1, upper=3.2)]), {}),
    "secondary-id": (lambda: desk(SECONDARY_ID=3), {}),
    "damaged": (ready_servos, {"alter": collide}),
    "other-rate": (lambda: desk(BAUD_RATE=FACTORY_RATE), {"hears_rate": True}),
    "voltage": (lambda: desk(PRESENT_INPUT_VOLTAGE=58), {}),
    "overload": (lambda: desk(HARDWARE_ERROR_STATUS=0b100000), {}),
    "homing-offset": (lambda: desk(HOMING_OFFSET=512), {}), "wrapped-angle": (lambda: at(1.6), {}),
}  # fmt: skip


@pytest.mark.nightly
def test_the_lines_of_a_servos_checks(serve):
    everywhere = {
        "no-answer": (lambda: desk(range(4), BAUD_RATE=FACTORY_RATE), {"hears_rate": True})
    }
    for name, (servos, served) in [*SERVOS.items(), *everywhere.items()]:
        config = desk_config(serve(servos(), **served).port)
        with named(name), closing(open_briefly(config)) as opened:
            said = "\n".join(map(str, check_servos(config, opened)))
            assert said.replace(config.bus.port, PORT) == LISTED[name]


RUNNING = {
    "silent": {"what": "lost", "ids": [2]},
    "late-running": {"what": "late", "ids": [2], "value": 0.012}, "unplugged": {"what": "unplug"},
    "voltage-running": {"what": "voltage", "ids": [2], "value": 5.8},
    "overload-running": {"what": "overload", "ids": [2]},
    "camera-running": None,  # it stalls
}  # fmt: skip


@pytest.mark.slow
def test_the_line_of_a_fault_while_the_robot_runs(monkeypatch):
    for name, fault in RUNNING.items():
        robot = VirtualRobot(monkeypatch)
        robot.begin()
        robot.step(0.0)
        if fault is None:
            robot.eyes[0].stalled_s = robot.clock()
        else:
            robot.fault(**fault)
        robot.follow(lambda _now_s: np.zeros((1, 7)), 2.0)
        said = robot.plant.fault.replace(VIRTUAL_PORT, PORT)
        age = r"none for 0\.5\d s"  # depends on the moment
        with named(name):
            assert re.sub(age, "", said) == re.sub(age, "", LISTED[name])


def test_the_line_of_an_adapter_that_holds_answers_back(monkeypatch):
    late = EmulatorConfig(answer_latency_s=0.016)
    robot = VirtualRobot(monkeypatch, World(HEAD, np.array([0.0, -0.1, 1.0]), late))
    with pytest.raises(ChecksFailedError) as failed:
        robot.plant.prepare()
    assert str(failed.value) == LISTED["late"]


CAMERAS = {
    "camera-time-out": (Desk(at0={"rate_hz": 0.0}, at2={}), {}, False),
    "camera-bandwidth": (Desk(40.0, at0={}, at2={}), {}, False),
    "camera-setting": (Desk(at0={"pixel_format": "YUYV"}, at2={}), {"pixel_format": "MJPG"}, True),
    "camera-exposure": (
        Desk(at0={"locked": 3, "exposure_s": 0.02}, at2={}), {"exposure_s": 0.008}, True,
    ),
}  # fmt: skip


def test_the_line_of_a_camera():
    for name, (cameras, asked, warning) in CAMERAS.items():
        with named(name):
            _states, findings = cameras.check(**asked)
            assert [(str(one), one.warning) for one in findings] == [(LISTED[name], warning)]


def test_the_line_of_a_port_without_permission(monkeypatch, tmp_path):
    port = tmp_path / "ttyUSB0"
    port.touch()

    def refuse(*_words):
        raise PermissionError(errno.EACCES, "no")

    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(ChecksFailedError) as failed:
        open_bus(str(port), 1_000_000)
    assert str(failed.value).replace(str(port), PORT) == LISTED["permission"]


def test_the_line_of_a_camera_without_permission(monkeypatch):
    shut = SimpleNamespace(set=lambda *_: False, isOpened=lambda: False, release=lambda: None)
    monkeypatch.setattr(image, "_open", lambda *_: shut)
    monkeypatch.setattr(os, "access", lambda *_: False)
    size = tuple(HEAD.cameras.size[0].tolist())
    request = CameraRequest(name="cameras.left", source="/dev/video0", size=size)
    (finding,) = check_cameras([request])[1]
    assert str(finding) == LISTED["camera-permission"]


def test_each_message_that_is_listed_is_compared():
    compared = {*SERVOS, *RUNNING, *CAMERAS, "permission", "camera-permission", "late"}
    assert set(LISTED) == compared
