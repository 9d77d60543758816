"""Wrong targets, pixels, poses and predictions are refused with the expected form."""

import itertools
import re

import numpy as np
import pytest

from tests.naming import named
from vergence import load_head
from vergence.errors import ConfigurationError
from vergence.vision import AprilTag, Camera, Detection, Tracker, make_detector, parse_target

IMAGE = np.full((480, 640), 120, np.uint8)
NONE = np.full((4, 2), np.nan)
SEEN = Detection(AprilTag(), NONE[0], NONE, NONE[0], NONE)
TAG = make_detector(AprilTag())
MIRROR = np.diag([1.0, 1.0, -1.0, 1.0])


def test_what_was_expected_is_said():
    for call, expected in [
        (lambda: make_detector("tag:36h11"), "target: expected a target, as parse_target makes"),
        (lambda: parse_target(None), "target: expected a printed board"),
        (lambda: Camera.of("head.toml", 0), "head: expected a head, see load_head"),
        (lambda: Camera.of(load_head("simulated"), 2), "eye: expected 0 for left or 1"),
        (lambda: TAG.detect(IMAGE, near_px=(np.nan, 1)), "near_px: expected a pixel (u, v)"),
        (lambda: TAG.search(IMAGE, near_px="there"), "near_px: expected a pixel (u, v)"),
        (lambda: TAG.search(IMAGE, way="half"), "way: expected a whole number or None"),
        (lambda: TAG.track(IMAGE, None), "predicted: expected a detection of tag:36h11:0"),
        (
            lambda: make_detector(parse_target("charuco:7x5:40:30:4X4_50")).track(IMAGE, SEEN),
            "predicted: expected a detection of charuco:7x5:40:30:4X4_50, got Detection",
        ),
        (
            lambda: TAG.track(IMAGE, SEEN._replace(corners_px=NONE[:3])),
            "predicted: expected corners_px of shape (4, 2), got (3, 2)",
        ),
        (lambda: Tracker(TAG).find(IMAGE, "left"), "predicted_px: expected a pixel (u, v)"),
        (lambda: Tracker(TAG).find(IMAGE, T_0_C="here"), "T_0_C: expected a pose (4, 4)"),
        (lambda: Tracker(TAG).find(IMAGE, T_0_C=MIRROR), "T_0_C: expected a pose (4, 4) with a"),
    ]:
        with named(call, expected), pytest.raises(ConfigurationError, match=re.escape(expected)):
            call()


def test_a_prediction_that_is_nowhere_finds_nothing():
    names = ("tag:36h11:0", "checkerboard:5x4", "charuco:7x5:40:30:4X4_50", "aprilgrid:6x6:88:0.3")
    for name, where in itertools.product(names, (np.nan, np.inf, 1e300)):
        with named(name, where):
            detector = make_detector(parse_target(name))
            corners = np.full((len(detector.target.corners_m), 2), where)
            seen = Detection(detector.target, corners[0], corners, corners[0], corners)
            assert detector.track(IMAGE, seen) is None
