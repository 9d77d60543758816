"""Faults of cameras: what is sent in place of an image, and what becomes of a stream."""

import threading
import time
import urllib.error
import urllib.request
from contextlib import closing
from functools import partial

import cv2
import numpy as np
import pytest

from tests.naming import named
from vergence.errors import HardwareError
from vergence.hardware.emulator.faults import CameraFaults, parse_fault
from vergence.hardware.emulator.server import EmulatedCameras, StreamConfig, make_stream_server


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


def test_a_camera_without_images_sends_none():
    for what in ("dropped", "stalled"):
        cameras = faulty({"what": what, "eye": "right"})
        assert cameras.apply_to_image(0, grey(20)) is not None
        assert cameras.apply_to_image(1, grey(20)) is None, what


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
        self.cameras = EmulatedCameras(self, self, StreamConfig(frame_rate_hz=200.0, latency_s=0.0))
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

    def begin(self, *faults):
        """Have faults, and wait until the cameras have them."""
        self.faults, drawn = list(faults), self.drawn
        until_s = time.monotonic() + 5.0
        while self.drawn < drawn + 3 and time.monotonic() < until_s:
            time.sleep(0.001)
        assert self.drawn >= drawn + 3

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
    for thread in rig._threads[:1]:
        thread.join(timeout=5.0)
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
        rig.begin({"what": "stalled", "eye": "right"})
        assert rig.cameras.streams[1].count == count
        rig.begin()
        assert b"image/jpeg" in stream.read()


def test_cameras_out_of_step_expose_one_after_the_other(rig):
    rig.begin({"what": "out-of-step", "value": 0.002})
    drawn, count = rig.drawn, rig.cameras.streams[0].count
    while rig.cameras.streams[0].count < count + 5:
        time.sleep(0.001)
    assert rig.drawn - drawn >= 8  # two for each of the left one's
