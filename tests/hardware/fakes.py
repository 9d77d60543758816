"""Cameras without devices, and time that passes only when somebody sleeps."""

import cv2
import numpy as np

from vergence import load_head
from vergence.hardware.config import CameraConfig, HardwareConfig, actuator_slots
from vergence.hardware.dynamixel.control_table import TICK_RAD
from vergence.hardware.servos import ServoConfig
from vergence.vision.targets import AprilTag


class FakeClock:
    def __init__(self, now=100.0):
        self.now = now

    def __call__(self):
        return self.now

    def sleep(self, seconds):
        self.now += seconds


class ScriptedCapture:
    """Images at given times of a fake clock; an image of None cannot be decoded."""

    def __init__(self, clock, times, image, stamped_before_s=None, hangs=False):
        self._hangs, self._count = hangs, 0
        self._clock, self._times, self._image = clock, list(times), image
        self._stamped_before_s = stamped_before_s
        self.released = 0

    def grab(self):
        if not self._times:
            return False
        self._clock.now = self._times.pop(0)
        return True

    def get(self, property):
        assert property == cv2.CAP_PROP_POS_MSEC
        if self._stamped_before_s is None:
            return 0.0
        return 1e3 * (self._clock.now - self._stamped_before_s)

    def retrieve(self):
        if self._image is None:
            return False, None
        image, self._count = self._image.copy(), self._count + (not self._hangs)
        image[0, 0] ^= np.uint8(self._count % 2)  # the next one is another
        return True, image

    def release(self):
        self.released += 1


def blank(head, eye=0, channels=1):
    width, height = head.cameras.size[eye].tolist()
    shape = (height, width) if channels == 1 else (height, width, channels)
    return np.full(shape, 110, np.uint8)


def with_tag(head, eye=0, corner=(200, 150), edge=96):
    """An image of tag 36h11:0, and the pixel of its middle."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    marker = cv2.aruco.generateImageMarker(dictionary, 0, edge)
    image = np.full_like(blank(head, eye), 255)
    x, y = corner
    image[y : y + edge, x : x + edge] = marker
    return image, np.array([x, y]) + 0.5 * (edge - 1)


HEAD = load_head("turrets")
TAG = AprilTag(family="36h11", id=0, edge_m=0.15)


def camera_config(eye=0, **values):
    usual = {"eye": eye, "source": "7", "pixel_format": "", "latency_s": 0.1}
    return CameraConfig(**usual | values)


def robot_config(bus, head=HEAD, limit_rad=1.5, latency_s=0.1, **more):
    """The configuration of a robot of a head, whose joints turn less than the head's limits."""
    lower, upper = head.actuation.lower, head.actuation.upper
    return HardwareConfig(
        path="robot.toml", head=head, target=TAG, bus=bus,
        servos=tuple(
            ServoConfig(
                name=name, slot=slot, id=id, zero=2048, unit_rad=TICK_RAD, sign=1, gear_ratio=1.0,
                lower_rad=max(-limit_rad, float(lower[slot])),
                upper_rad=min(limit_rad, float(upper[slot])),
            )
            for id, (name, slot) in enumerate(actuator_slots(head).items(), 1)
        ),
        cameras=tuple(camera_config(i, source=f"{7 + i}", latency_s=latency_s) for i in range(2)),
        pairing_tolerance_s=0.75 * head.timing.frame_s, emulator_address="", **more,
    )  # fmt: skip
