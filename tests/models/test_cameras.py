"""Cameras: the pair of a head, what cannot be one, and the light that grey levels stand for."""

import numpy as np
import pytest

from tests.models.lenses import LENSES
from tests.naming import named, refused
from vergence.models.camera import Camera, Cameras, camera_matrix, light_table, parse_response

CAMERA = Camera(size=(320, 240), matrix=camera_matrix((500.0, 500.0), (150.0, 120.0)))


def cameras(**fields) -> Cameras:
    return Cameras(CAMERA, CAMERA).replaced(**({"size": (640, 480)} | fields))


def test_one_size_lens_or_response_stands_for_both_eyes_and_coefficients_are_filled_up():
    made = cameras(lens="fisheye", distortion=np.full((2, 4), 0.1))
    assert made == cameras(lens=["fisheye", "fisheye"], distortion=made.distortion)
    assert made.size.tolist() == [[640, 480], [640, 480]]
    assert made.size.dtype == np.int64
    assert made.lens == ("fisheye", "fisheye")
    assert made.response == (None, None)
    for given, pair in [
        ("srgb", ("srgb", "srgb")), ([0.0, 0.2, 1.0], ((0.0, 0.2, 1.0), (0.0, 0.2, 1.0))),
        ((None, 2.2), (None, 2.2)),
    ]:  # fmt: skip
        with named(given, pair):
            assert cameras(response=given).response == pair
    # two lenses of five coefficients have five columns, and others eight
    assert cameras(distortion=np.zeros((3, 2, 4))).distortion.shape == (3, 2, 5)
    assert cameras(distortion=np.zeros((2, 8))).distortion.shape == (2, 5)
    for lens in LENSES[1:]:
        given = [[0.1, 0.2, 0.3, 0.4, 0.0], [0.5, 0.6, 0.7, 0.8, 0.9]]
        made = cameras(lens=(lens, "brown-conrady"), distortion=given)
        np.testing.assert_array_equal(made.distortion, np.pad(given, ((0, 0), (0, 3))))


def test_what_cannot_be_is_refused_with_what_came():
    for fields, message in [
        ({"size": (640, 480, 3)}, r"size: .* for both eyes or for each, got \(640, 480, 3\)"),
        *(({"size": size}, "size: expected .*whole pixels") for size in (
            (640.5, 480), (0, 480), (np.nan, 480),
        )),
        ({"lens": "pinhole"}, "lens: expected one of brown-conrady, rational, fisheye, got 'pinh"),
        ({"lens": 3}, "lens: expected a name for each eye, got 3"),
        ({"distortion": np.zeros((2, 3))}, "distortion: expected 5 numbers, got 3"),
        ({"distortion": np.zeros((3, 5))}, r"distortion: expected shape \(..., 2, n\), got"),
        ({"focus": 3.0}, "cameras.focus: expected one of size, focal"),
        ({"distortion": np.ones((2, 8))}, "5 coefficients for the left eye's brown-conrady lens"),
    ]:  # fmt: skip
        refused(message, cameras, **fields)


def test_without_distortion_the_projection_is_a_pinhole_before_the_camera(physical, head):
    rest, point = np.zeros(7), np.array([0.1, -0.1, 0.8])
    camera = np.linalg.inv(physical.camera_poses(rest)) @ [*point, 1.0]
    expected = physical.cameras.principal + physical.cameras.focal * camera[:, :2] / camera[:, 2:3]
    pixels = physical.project(rest, point, distorted=False)
    np.testing.assert_allclose(pixels, expected, atol=1e-9)
    for z in (-1.0, 0.0138):
        # 0.1 m further back, as a drawn head's cameras may look slightly aside
        assert np.isnan(head.project(rest, np.array([0.0, 0.0, z - 0.1]))).all(), z


def test_a_table_holds_the_light_at_levels_in_equal_steps():
    levels = np.arange(256)
    np.testing.assert_allclose(light_table("linear"), levels)
    np.testing.assert_allclose(light_table(2.0), 255.0 * (levels / 255.0) ** 2)
    light = light_table(parse_response([0.0, 0.2, 1.0]))
    assert np.interp(127.5, levels, light) == pytest.approx(0.2 * 255.0, rel=1e-2)
    # half of the light is level 187.5, a fifth of all levels 3.3 % (IEC 61966-2-1)
    light = light_table("srgb") / 255.0
    assert np.interp(0.5, light, levels) == pytest.approx(187.5, abs=0.1)
    assert light[51] == pytest.approx(0.0331, abs=1e-4)


def test_what_names_a_response_and_what_is_none():
    for text, response in [
        ("srgb", "srgb"), ("2.2", 2.2), (1, "linear"), ([0, 1], (0.0, 1.0)),
        ("0,0.2, 1", (0.0, 0.2, 1.0)),
    ]:  # fmt: skip
        with named(text, response):
            assert parse_response(text) == response
    said = "response: expected 'linear', 'srgb', a gamma"
    for value in (
        "sRGB!", "0,x,1", 0.0, -2.2, np.nan, True, None, [0.0, 0.5], [0.0, 0.6, 0.5, 1.0], [1.0],
        object(), 1j,
    ):  # fmt: skip
        refused(said, parse_response, value)
