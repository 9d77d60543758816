"""A head measured with a ruler: its geometry is that of the measures, by hand."""

import dataclasses
from math import cos, radians, sin, tan

import numpy as np
import pytest

from tests.naming import refused
from vergence.models import parse_head
from vergence.models.ruler import Ruler, find_servo_model, ruler_to_toml

MEASURED = Ruler(
    name="measured", baseline=120.0, axes_apart=100.0, height=150.0, axes_ahead=15.0,
    lens_ahead=25.0, view=60.0, servo=find_servo_model("XL430"),
)  # fmt: skip


def lenses(ruler: Ruler, angles: dict[str, float]) -> np.ndarray:
    """(2, 3) positions of the lenses in frame 0, mm, at joint angles in degrees."""
    head = parse_head(ruler_to_toml(ruler))
    q = np.array([radians(angles.get(name, 0.0)) for name in head.joints])
    return 1e3 * (head.base_pose(q) @ head.camera_poses(q))[:, :3, 3]


def test_lenses_turn_about_the_axes_that_were_measured_from_where_they_were_measured():
    rest = lenses(MEASURED, {})
    np.testing.assert_allclose(rest, [[-60.0, -150.0, 40.0], [60.0, -150.0, 40.0]], atol=1e-9)
    left, right = lenses(MEASURED, {"left_pan": 30.0, "right_tilt": 20.0})
    c, s = cos(radians(30.0)), sin(radians(30.0))
    # 40 mm ahead of the pan axis and 10 mm left of it; a positive pan turns right
    np.testing.assert_allclose(left, [-50 - 10 * c + 40 * s, -150, 10 * s + 40 * c], atol=1e-9)
    c, s = cos(radians(20.0)), sin(radians(20.0))
    # 25 mm ahead of the tilt axis and 40 mm above it; a positive tilt looks up
    wanted = [60.0, -110.0 - 40 * c - 25 * s, 15.0 + 25 * c - 40 * s]
    np.testing.assert_allclose(right, wanted, atol=1e-9)


@pytest.mark.parametrize("mount", ["turrets", "neck"])
@pytest.mark.parametrize("first", ["pan", "tilt"])
def test_every_build_looks_at_a_point_ahead(mount, first):
    apart = 100.0 if mount == "turrets" else None
    ruler = dataclasses.replace(MEASURED, mount=mount, first=first, axes_apart=apart, fps=150.0)
    head = parse_head(ruler_to_toml(ruler))
    target = [0.05, -0.02, 0.8]
    off = head.project(head.fixate(target), target) - head.cameras.principal
    error = np.linalg.norm(off, axis=-1)
    # a neck turns both eyes alike: their errors are equal halves of the disparity
    half = 0.5 * 0.12 / 0.8 * 554.256
    assert error == pytest.approx([0.0, 0.0] if mount == "turrets" else [half, half], abs=1.5)


def test_a_view_is_that_of_a_pinhole_and_a_tilt_axis_above_the_plate():
    assert MEASURED.focal_px == pytest.approx(320 / tan(radians(30.0)))
    diagonal = dataclasses.replace(MEASURED, view=None, diagonal=60.0)
    assert diagonal.focal_px == pytest.approx(400 / tan(radians(30.0)))
    refused("height: expected at least", dataclasses.replace, MEASURED, height=30.0)
    refused("expected none with --mount neck", dataclasses.replace, MEASURED, mount="neck")


def test_servos_are_found_by_the_beginning_of_their_names():
    for text, name in [
        ("xl330", "XL330-M288"), ("XL430-W250-T", "XL430-W250"), ("xm430w210", "XM430-W210"),
        ("STS3215", "STS3215"), ("hobby", "hobby"), ("XM430-W350-R", "XM430-W350"),
    ]:  # fmt: skip
        assert find_servo_model(text).name == name, text
