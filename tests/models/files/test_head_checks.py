"""Heads that no person could have meant, and what they are told."""

import numpy as np
import pytest

from tests.heads import CENTRE, IMAGE, LOOP, actuator, eyes, joint, text_of
from tests.naming import named
from vergence.errors import HeadFileError
from vergence.models import parse_head


def pans(left: float, right: float) -> str:
    """Two eyes that pan and tilt, at places along x."""
    return "".join(
        joint(f"{eye}_pan", eye, (x, 0, 0), (0, 1, 0))
        + joint(f"{eye}_tilt", eye, CENTRE, (1, 0, 0))
        for eye, x in (("left", left), ("right", right))
    )


def test_exchanged_eyes_are_told():
    right = 'name = "desk"\n' + pans(-0.04, 0.04) + IMAGE + eyes() + LOOP
    assert parse_head(right).camera_poses(np.zeros(7))[1, 0, 3] == pytest.approx(0.04)
    wrong = 'name = "desk"\n' + pans(0.04, -0.04) + IMAGE + eyes() + LOOP
    with pytest.raises(HeadFileError, match=r"are left and right exchanged.*got .*80\.0 mm"):
        parse_head(wrong)


def test_exchanged_cameras_of_a_fixed_pair_are_told():
    with pytest.raises(HeadFileError, match="are left and right exchanged"):
        parse_head('name = "pair"\n' + IMAGE + eyes((0.05, 0, 0), (-0.05, 0, 0)) + LOOP)


def test_a_joint_that_turns_about_the_optical_axis_is_named():
    text = text_of("panfirst").replace("axis = [0.0, 1.0, 0.0]", "axis = [0.0, 0.0, 1.0]", 1)
    with pytest.raises(HeadFileError, match=r"left_pan and left_tilt to move the image"):
        parse_head(text)
    text = text_of("common").replace("axis = [0.0, 1.0, 0.0]", "axis = [0.0, 0.0, 1.0]", 1)
    with pytest.raises(HeadFileError, match=r"joints moved by pan: expected pan, tilt each"):
        parse_head(text)


def test_a_joint_that_no_actuator_moves_is_named():
    text = 'name = "desk"\n' + pans(-0.04, 0.04) + IMAGE + eyes() + LOOP
    with pytest.raises(HeadFileError, match=r"none that moves left_pan, right_pan, right_tilt"):
        parse_head(text + actuator("tilt", "left_tilt = 1.0"))


def test_the_joints_that_an_actuator_may_move_are_named_once():
    text = text_of("tied").replace("eyes_tilt = 1.0", "eye_tilt = 1.0")
    with pytest.raises(HeadFileError, match=r": eyes_tilt, left_pan, right_pan, got 'eye_tilt'"):
        parse_head(text)


def test_angles_counted_from_far_away_are_told_before_what_follows_from_it():
    text = text_of("panfirst")
    far = text.replace("lower_rad = -0.9\nupper_rad = 0.9", "lower_rad = 2.0\nupper_rad = 4.5", 1)
    with pytest.raises(HeadFileError, match=r"limits of left_pan: expected .*of zero.*2\.0, 4\.5"):
        parse_head(far)


def test_eyes_at_one_place_and_eyes_apart_are_told_as_such():
    with pytest.raises(HeadFileError, match="eyes: expected cameras at two places"):
        parse_head('name = "pair"\n' + IMAGE + eyes((0.05, 0, 0), (0.05, 0, 0)) + LOOP)
    one_behind = 'name = "pair"\n' + IMAGE + eyes((0, 0, 0), (0, 0, 0.1)) + LOOP
    with pytest.raises(HeadFileError, match=r"side by side.*axes 0 degrees apart.* 0\.0 mm beside"):
        parse_head(one_behind)


def test_a_table_whose_name_is_misspelt_is_told_by_what_it_is_meant_for():
    text = text_of("common").replace("[[joints]]", "[[joint]]")
    with pytest.raises(HeadFileError, match=r"^joint: expected no such key \(is joints meant\?\)"):
        parse_head(text)
    text = text_of("pair").replace("[timing]\n", "[timing]\nlatency = 0.1\n")
    with pytest.raises(HeadFileError, match=r"latency: expected no such key \(is timing.latency_s"):
        parse_head(text)


def test_coefficients_of_a_lens_without_its_name_are_told_the_name():
    for count, lens in [(4, "fisheye"), (8, "rational")]:
        with named(count, lens):
            text = text_of("pair").replace("[0.0, 0.0, 0.0, 0.0, 0.0]", str([0.01] * count), 1)
            with pytest.raises(HeadFileError, match=f"expected 5 numbers, or lens = '{lens}'"):
                parse_head(text)


def test_encoder_steps_in_degrees_are_told():
    text = text_of("pair").replace("r_resolution_rad = 0.0", "r_resolution_rad = 0.0879")
    with pytest.raises(HeadFileError, match=r"encoder_resolution_rad: .*is it in degrees"):
        parse_head(text)
