"""Faults as people write them: what is refused, and what is taken for granted."""

import math
import threading
import time
import urllib.error
import urllib.request
from contextlib import closing
from functools import partial

import cv2
import numpy as np
import pytest

from tests.commands.test_failures import call
from tests.naming import named
from vergence.errors import HardwareError, HeadFileError
from vergence.hardware.emulator.config import EmulatorConfig
from vergence.hardware.emulator.faults import CameraFaults, load_faults, parse_fault
from vergence.hardware.emulator.server import EmulatedCameras, make_stream_server

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
    assert [parsed(what="torn").eye, parsed(what="torn", eye="left").eye] == ["both", "left"]


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


def grey(value):
    return np.full((8, 8), value, np.uint8)


def faulty(*faults):
    """Faults of cameras that have sent an image of 10 in health."""
    cameras = CameraFaults(np.random.default_rng(0))
    for eye in (0, 1):
        cameras.apply_to_image(eye, grey(10))
    cameras.set_active([parse_fault(fault, (), timed=False) for fault in faults])
    return cameras


def test_a_frozen_camera_sends_its_last_image_again():
    cameras = faulty({"what": "frozen", "eye": "left"})
    assert [int(cameras.apply_to_image(0, grey(value)).mean()) for value in (20, 30)] == [10, 10]
    assert (cameras.apply_to_image(1, grey(20)) == 20).all()
    cameras.set_active([])
    assert (cameras.apply_to_image(0, grey(40)) == 40).all()


def test_a_torn_image_is_new_above_and_old_below():
    image = faulty({"what": "torn"}).apply_to_image(0, grey(20))
    assert (image[[3, 4], 0] == [20, 10]).all()


@pytest.mark.parametrize("what", ["dropped", "stalled"])
def test_a_camera_without_images_sends_none(what):
    cameras = faulty({"what": what, "eye": "right"})
    assert cameras.apply_to_image(0, grey(20)) is not None
    assert cameras.apply_to_image(1, grey(20)) is None


def test_images_are_dropped_with_the_faults_probability():
    cameras = faulty({"what": "dropped", "probability": 0.25})
    kept = sum(cameras.apply_to_image(0, grey(20)) is not None for _ in range(1200))
    # 900 expected, with a standard deviation of 15
    assert 840 < kept < 960


def test_cameras_are_late_and_out_of_step_by_the_faults_value():
    cameras = faulty({"what": "late", "eye": "left", "value": 0.2}, {"what": "out-of-step"})
    assert (cameras.send_delay_s(0), cameras.send_delay_s(1)) == (0.2, 0.0)
    assert cameras.right_exposure_delay_s == 0.0167


class Rig:
    """Streams of grey images, each brighter than the one before, with the faults of the test."""

    def __init__(self):
        self.faults, self.over, self.drawn = [], False, 0
        self.cameras = EmulatedCameras(self, self, EmulatorConfig(), 200.0, 0.0)
        self.server = make_stream_server(self.cameras, 0)
        self.url = f"http://127.0.0.1:{self.server.server_address[1]}"
        serve = partial(self.server.serve_forever, poll_interval=0.01)
        self._threads = [threading.Thread(target=one) for one in (self._run, serve)]
        for thread in self._threads:
            thread.start()

    def ask(self, request):
        if self.over:
            raise HardwareError("over")
        state = {name: [0.0] for name in ("positions", "velocities", "target", "target_velocity")}
        return {**state, "target_axes": None, "faults": self.faults}

    def draw(self, *_words):
        self.drawn += 1
        image = np.full((32, 32), self.drawn % 200, np.uint8)  # more than the corner with noise
        return image, image.copy()

    def _run(self):
        with pytest.raises(HardwareError):
            self.cameras.run()

    def open(self, eye, images):
        return urllib.request.urlopen(f"{self.url}/{eye}?images={images}", timeout=5.0)

    def pictures(self, eye, images):
        parts = self.open(eye, images).read().split(b"\xff\xd8")[1:]
        arrays = [np.frombuffer(b"\xff\xd8" + part, np.uint8) for part in parts]
        return [cv2.imdecode(one, cv2.IMREAD_GRAYSCALE).mean() for one in arrays]

    def draw_again(self, count=3):
        """Wait for some drawings; faults are those of the last one."""
        drawn, until_s = self.drawn, time.monotonic() + 5.0
        while self.drawn < drawn + count:
            assert time.monotonic() < until_s
            time.sleep(0.001)

    def begin(self, *faults):
        """Have faults, and wait until the cameras have them."""
        self.faults = list(faults)
        self.draw_again()

    def close(self):
        self.over = True
        self.server.shutdown()
        self.server.server_close()
        for thread in self._threads:
            thread.join()


@pytest.fixture
def rig():
    with closing(Rig()) as one:
        yield one


def test_a_number_of_images_that_cannot_be_is_refused(rig):
    for images in ("--5", "-2", "many", "9" * 5000):
        with named(images), pytest.raises(urllib.error.HTTPError, match="404"):
            rig.open("left", images)


def test_an_image_that_a_later_one_has_overtaken_is_dropped(rig):
    rig.over = True  # no further images of its own
    rig._threads[0].join(timeout=5.0)
    stream = rig.cameras.streams[0]
    stream.publish(b"new", 1e9)
    count = stream.count
    stream.publish(b"old", 1e9 - 1.0)
    assert (stream.count, stream.next(count - 1)[0]) == (count, b"new")


def test_a_frozen_stream_goes_on_with_one_image(rig):
    assert len(set(rig.pictures("left", 4))) == 4
    rig.begin({"what": "frozen", "eye": "left"})
    assert len(set(rig.pictures("left", 4))) == 1
    assert len(set(rig.pictures("right", 4))) == 4


def test_a_stream_that_ends_is_closed_and_may_be_opened_again_later(rig):
    open_before = rig.open("right", -1)
    rig.begin({"what": "ended", "eye": "right"})
    open_before.read()  # to its end
    with pytest.raises(urllib.error.HTTPError, match="503"):
        rig.open("right", 1)
    assert len(rig.pictures("left", 1)) == 1
    rig.begin()
    assert len(rig.pictures("right", 1)) == 1


def test_a_stalled_stream_stays_open_without_images(rig):
    rig.begin({"what": "stalled", "eye": "right"})
    count = rig.cameras.streams[1].count
    with rig.open("right", 1) as stream:
        rig.draw_again()
        assert rig.cameras.streams[1].count == count
        rig.begin()
        assert b"image/jpeg" in stream.read()


def test_cameras_out_of_step_expose_one_after_the_other(rig):
    rig.begin({"what": "out-of-step", "value": 0.002})
    count = rig.cameras.streams[0].count
    rig.draw_again(10)
    assert rig.cameras.streams[0].count - count <= 6  # one for every two drawings
