"""Heads that no person could have meant, and what they are told."""

from collections.abc import Sequence

import numpy as np
import pytest

from tests.heads import CENTRE, IMAGE, LOOP, actuator, eyes, joint, text_of
from tests.naming import named
from vergence.errors import HeadFileError
from vergence.models import parse_head


def desk(left: float, right: float) -> str:
    """Two eyes that pan and tilt, at places along x."""
    joints = "".join(
        joint(f"{eye}_pan", eye, (x, 0, 0), (0, 1, 0))
        + joint(f"{eye}_tilt", eye, CENTRE, (1, 0, 0))
        for eye, x in (("left", left), ("right", right))
    )
    return 'name = "desk"\n' + joints + IMAGE + eyes() + LOOP


def pair(left: Sequence[float], right: Sequence[float]) -> str:
    return 'name = "pair"\n' + IMAGE + eyes(left, right) + LOOP


def test_what_cannot_be_and_what_was_meant_is_told():
    assert parse_head(desk(-0.04, 0.04)).camera_poses(np.zeros(7))[1, 0, 3] == pytest.approx(0.04)
    panfirst, pan, rolls = text_of("panfirst"), "axis = [0.0, 1.0, 0.0]", "axis = [0.0, 0.0, 1.0]"
    near, far = "lower_rad = -0.9\nupper_rad = 0.9", "lower_rad = 2.0\nupper_rad = 4.5"
    for text, said in [
        (desk(0.04, -0.04), r"are left and right exchanged.*got .*80\.0 mm"),
        (pair((0.05, 0, 0), (-0.05, 0, 0)), "are left and right exchanged"),
        (pair((0.05, 0, 0), (0.05, 0, 0)), "eyes: expected cameras at two places"),
        (pair((0, 0, 0), (0, 0, 0.1)), r"side by side.*axes 0 degrees apart.* 0\.0 mm beside"),
        # a joint that turns about the optical axis
        (panfirst.replace(pan, rolls, 1), "left_pan and left_tilt to move the image"),
        (text_of("common").replace(pan, rolls, 1), "joints moved by pan: expected pan, tilt each"),
        # before what follows from it
        (panfirst.replace(near, far, 1), r"limits of left_pan: expected .*of zero.*2\.0, 4\.5"),
        (desk(-0.04, 0.04) + actuator("tilt", "left_tilt = 1.0"),
         "none that moves left_pan, right_pan, right_tilt"),
        (text_of("tied").replace("eyes_tilt = 1.0", "eye_tilt = 1.0"),
         ": eyes_tilt, left_pan, right_pan, got 'eye_tilt'"),
    ]:  # fmt: skip
        with named(said), pytest.raises(HeadFileError, match=said):
            parse_head(text)
    coefficients = "[0.0, 0.0, 0.0, 0.0, 0.0]"
    for name, given, wrong, said in [
        ("common", "[[joints]]", "[[joint]]", r"^joint: expected no such key \(is joints m"),
        ("pair", "[timing]\n", "[timing]\nlatency = 0.1\n", r"such key \(is timing.latency_s"),
        ("pair", coefficients, str([0.01] * 4), "expected 5 numbers, or lens = 'fisheye'"),
        ("pair", coefficients, str([0.01] * 8), "expected 5 numbers, or lens = 'rational'"),
        ("pair", "r_resolution_rad = 0.0", "r_resolution_rad = 0.0879",
         "encoder_resolution_rad: .*is it in degrees"),
    ]:  # fmt: skip
        text = text_of(name).replace(given, wrong, -1 if name == "common" else 1)
        with named(wrong), pytest.raises(HeadFileError, match=said):
            parse_head(text)
