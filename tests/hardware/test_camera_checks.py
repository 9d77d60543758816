"""Checks of both cameras, on captures whose time passes by their own images, and their command."""

import threading

import cv2
import numpy as np
import pytest

from tests.commands.test_failures import call
from tests.hardware.fakes import HEAD, blank
from tests.hardware.line import desk_config
from tests.naming import named
from vergence.errors import ConfigurationError
from vergence.hardware import checks as camera_checks
from vergence.hardware.checks import CameraRequest, camera_requests, check_cameras

ASKED = {"size": (640, 480), "frame_rate_hz": 30.0}


class ThreadClock(threading.local):
    now = 100.0

    def __call__(self):
        return self.now


class Desk:
    """Cameras, by source what each one is, that share a bandwidth in images a second."""

    def __init__(self, shared_hz=1e6, **cameras):
        self.clock = ThreadClock()
        self.shared_hz, self.cameras = shared_hz, cameras
        self.open = []

    def open_capture(self, source, what, **asked):
        values = self.cameras[f"at{source}"]
        if "error" in values:
            raise ConfigurationError(f"{what}: expected a camera, got {values['error']}")
        return FakeCamera(self, asked, values)

    def check(self, **asked):
        requests = [
            CameraRequest(name=f"cameras.{name}", source=source, **ASKED | asked)
            for name, source in (("left", "0"), ("right", "2"))
        ]
        found = check_cameras(requests, open=self.open_capture, clock=self.clock)
        assert self.open == []
        return found


class FakeCamera:
    def __init__(self, desk, asked, values):
        usual = {"rate_hz": 30.0, "size": asked["size"] or (640, 480), "locked": 1}
        usual |= {"set_hz": asked["frame_rate_hz"] or 30.0, "starves": False}
        usual |= {name: asked[name] for name in ("pixel_format", "exposure_s")}
        self._desk, self._values = desk, usual | values
        desk.open.append(self)

    def grab(self):
        count = len(self._desk.open)
        rate = min(self._values["rate_hz"], self._desk.shared_hz / count)
        if rate <= 0.0 or (count > 1 and self._values["starves"]):
            self._desk.clock.now += 10.0
            return False
        self._desk.clock.now += 1.0 / rate
        return True

    def retrieve(self):
        width, height = self._values["size"]
        return True, blank(HEAD)[:height, :width]

    def get(self, prop):
        letters = self._values["pixel_format"]
        return {
            cv2.CAP_PROP_FPS: self._values["set_hz"],
            cv2.CAP_PROP_FOURCC: float(cv2.VideoWriter.fourcc(*letters)) if letters else 0.0,
            cv2.CAP_PROP_AUTO_EXPOSURE: float(self._values["locked"]),
            cv2.CAP_PROP_EXPOSURE: 1e4 * (self._values["exposure_s"] or 0.0),
        }[prop]

    def release(self):
        self._desk.open.remove(self)


def test_cameras_with_nothing_wrong_have_no_findings():
    states, found = Desk(at0={}, at2={}).check(pixel_format="MJPG", exposure_s=0.008)
    assert found == []
    for state in states:
        assert (state.size, state.pixel_format, state.exposure_locked) == ((640, 480), "MJPG", True)
        assert (state.rate_hz, state.exposure_s) == pytest.approx((30.0, 0.008))


FOUND = [
    ({"size": (320, 240)}, "expected images of 640 x 480, as the head has them, got 320 x 240", 0),
    ({"rate_hz": 23.0}, "expected 30 images a second, got 23", 0),
    ({"set_hz": 25.0}, "expected the setting of 30 images a second to be kept, got 25", 1),
    ({"exposure_s": 0.02}, "expected an exposure locked to 0.008 s, got locked, 0.02 s", 1),
    ({"error": "2: no such device"}, "expected a camera, got 2: no such device", 0),
]


def test_a_camera_that_gives_something_else_is_one_finding():
    for values, said, warning in FOUND:
        with named(values):
            desk = Desk(at0={}, at2=values)
            _states, (finding,) = desk.check(pixel_format="MJPG", exposure_s=0.008)
            assert finding.part == "cameras.right"
            assert said in finding.problem
            assert finding.cure
            assert finding.warning == bool(warning)


def test_cameras_that_are_slow_only_together_are_the_controllers_limit():
    states, (finding,) = Desk(shared_hz=30.0, at0={}, at2={}).check()
    assert finding.part == "cameras"
    assert "cameras.left 15 (30 alone); cameras.right 15 (30 alone)" in finding.problem
    assert "MJPG" in finding.cure
    assert [state.slowed_by_others for state in states] == [True, True]


def test_a_camera_that_starts_only_alone_is_the_controllers_limit():
    _states, (finding,) = Desk(at0={}, at2={"starves": True}).check()
    assert "cameras.right 0 (30 alone)" in finding.problem


def test_a_streams_settings_are_not_judged():
    request = CameraRequest(name="left", source="http://left", **ASKED, exposure_s=0.01)
    desk = Desk(**{"athttp://left": {"locked": 3, "pixel_format": "H264"}})
    states, found = check_cameras([request], open=desk.open_capture, clock=desk.clock)
    assert found == []
    assert (states[0].pixel_format, states[0].exposure_locked) == ("", None)


def test_a_robots_cameras_are_asked_for_what_the_head_has():
    left, right = camera_requests(desk_config("/dev/ttyNONE"))
    assert (left.name, left.source, right.source) == ("cameras.left", "7", "8")
    assert (left.size, left.frame_rate_hz) == ((640, 480), 30.0)


def test_the_command_shows_what_was_asked_and_what_came(tmp_path, capsys):
    path = str(tmp_path / "film.avi")
    film = cv2.VideoWriter(path, cv2.VideoWriter.fourcc(*"MJPG"), 30.0, (64, 48))
    for _ in range(5):
        film.write(np.zeros((48, 64, 3), np.uint8))
    film.release()
    assert call("check-cameras", path) == 0
    said = capsys.readouterr().out
    for word in ("film.avi", "64 x 48", "rate measured"):
        assert word in said


def test_the_command_tells_errors_before_warnings_and_fails_by_errors_alone(monkeypatch, capsys):
    desk = Desk(at0={"locked": 3}, at2={"rate_hz": 15.0})

    def check(requests):
        return check_cameras(requests, open=desk.open_capture, clock=desk.clock)

    monkeypatch.setattr(camera_checks, "check_cameras", check)
    assert call("check-cameras", "0", "2", "--size", "640x480", "--rate", "30") == 1
    said = capsys.readouterr()
    lines = said.err.splitlines()
    assert lines[0].startswith("vergence: error: 2: expected 30 images a second, got 15")
    assert lines[1].startswith("vergence: warning: 0: expected a locked exposure")
    assert "exposure_s = 0.008 in [0]" in lines[1]
    assert "automatic" in said.out
    assert call("check-cameras", "0") == 0


def test_words_that_cannot_be_are_misuse(capsys):
    for words, said in (
        ([], "expected either --config PATH or cameras"),
        (["0", "--rate", "0"], "rate: expected images a second"),
        (["0", "--pixel-format", "MJPEG"], "pixel-format: expected four letters"),
        (["--config", "none.toml", "--rate", "30"], "expected with cameras, got --config"),
    ):
        with named(words):
            assert call("check-cameras", *words) == 2
            assert said in capsys.readouterr().err
