"""Drawn images against an independent ray cast."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.ray_cast import ray_cast
from tests.models.lenses import wide
from tests.naming import named, refused
from tests.vision.poses import pose
from tests.vision.scenes import CAMERA, rig
from tests.vision.scenes import RENDERING as PLAIN
from vergence.models.camera import light_table
from vergence.vision import AprilTag, Camera, TargetRenderer, make_planar_target
from vergence.vision.targets import board_pose

RENDERING = replace(PLAIN, supersampling=2)
ASIDE, STEEP = np.deg2rad(60.0), np.deg2rad(65.0)
RAY_CASTS = {
    "through a lens": (
        "physical", "tag", pose(0.02, -0.01, 1.2, (0.2, 0.4, 0.1)), {}, 0.04, 0.005
    ),
    "through a pinhole": (
        "simulated", "checkerboard", pose(0.05, 0.03, 2.4, (-0.3, 0.2, 0.5)), {}, 0.04, 0.005,
    ),
    # aside, where it has down to a quarter of a pinhole's scale
    "through a fisheye": (
        "fisheye", "tag", board_pose(1.6 * np.array([np.sin(ASIDE), 0.05, np.cos(ASIDE)])), {},
        0.05, 0.01,
    ),
    # half as much blur again would be off by twice as much and more
    "by one sample a pixel": (
        "simulated", "tag", pose(0.013, 0.02, 1.9, (0.3, -0.4, 0.2)), {"supersampling": 1},
        0.075, 0.009,
    ),
    # one blur for both directions of the texture would be off by 2 % rms and more
    "steep": (
        "physical", "tag", pose(0.02, 0.03, 1.2, (STEEP * np.cos(0.8), STEEP * np.sin(0.8), 0.0)),
        {"blur_px": 0.7, "supersampling": 3}, 0.04, 0.008,
    ),
    # cut, not moved
    "across the frame's edge": (
        "physical", "tag", pose(-1.02, -0.6, 1.5, (0.1, 0.2, 0)), {}, 0.04, 0.02,
    ),
}  # fmt: skip
"""Eye, target, T_C_T, changes of the rendering, and errors as shares of the contrast: the largest
and the rms, a third of which is the rounding in the first."""


@pytest.mark.slow
@pytest.mark.parametrize("case", RAY_CASTS)
def test_pixels_equal_a_ray_cast(case):
    eye, name, T_C_T, change, most, rms = RAY_CASTS[case]
    camera = Camera.of(wide(eye), 0) if eye == "fisheye" else rig(eye)[0]
    target, rendering = make_planar_target(name), replace(RENDERING, **change)
    drawing = TargetRenderer(camera, target, rendering)
    drawing.draw(T_C_T)
    x0, y0, x1, y1 = drawing.region
    assert ((x0, y0) == (0, 0)) == (case == "across the frame's edge")
    error = drawing.frame[y0:y1, x0:x1] - ray_cast(camera, target, rendering, T_C_T, drawing.region)
    assert np.abs(error).max() < most * 170
    assert np.sqrt((error**2).mean()) < rms * 170


def test_a_stated_response_encodes_the_light():
    """Within what levels of 8 bits hold of light: two of 255 where it is bright."""
    light, target, T_C_T = light_table("srgb"), make_planar_target("tag"), pose(0, 0, 0.8)
    encoded = TargetRenderer(replace(CAMERA, response="srgb"), target, RENDERING)
    linear = TargetRenderer(
        CAMERA,
        target,
        replace(RENDERING, black_grey=light[40], white_grey=light[210], background_grey=light[120]),
    )
    for drawing in (encoded, linear):
        drawing.draw(T_C_T)
    np.testing.assert_allclose(light[encoded.frame], linear.frame, atol=2.0)
    x0, y0, x1, y1 = encoded.region
    middle = encoded.frame[(y0 + y1) // 2, x0:x1]  # from the background to black and white
    assert {middle[0], middle.min(), middle.max()} == {120, 40, 210}


def test_unseen_target_leaves_plain_background():
    for T_C_T in [
        pose(0, 0, -1.0), pose(2.0, 0, 1.0), pose(0, 0, 1.0, (np.pi, 0, 0)), pose(0, 0, 0.01),
    ]:  # fmt: skip
        with named(T_C_T):
            drawing = TargetRenderer(CAMERA, AprilTag(), RENDERING)
            drawing.draw(pose(0, 0, 1.0), np.random.default_rng(0))
            drawing.draw(T_C_T, np.random.default_rng(0))
            assert drawing.region is None
            assert (drawing.frame == 120).all()


def test_nothing_of_the_last_frame_remains():
    drawing, fresh = (TargetRenderer(CAMERA, AprilTag(), RENDERING) for _ in range(2))
    drawing.draw(pose(0.1, 0.1, 0.6), np.random.default_rng(1), smear_px=(20.0, 5.0))
    for each in (drawing, fresh):
        each.draw(pose(-0.1, 0, 1.5), np.random.default_rng(2))
    assert (drawing.frame == fresh.frame).all()


def test_same_seed_same_image():
    drawing = TargetRenderer(CAMERA, AprilTag(), RENDERING)
    images = []
    for each, seed in ((drawing, 5), (pickle.loads(pickle.dumps(drawing)), 5), (drawing, 6)):
        each.draw(pose(0, 0, 1), np.random.default_rng(seed))
        images.append(each.frame.copy())
    assert images[0].dtype == np.uint8
    assert (images[0] == images[1]).all()
    assert (images[0] != images[2]).any()


@pytest.mark.slow
def test_noise_has_the_stated_deviation_and_is_white():
    drawing = TargetRenderer(CAMERA, AprilTag(), replace(RENDERING, noise_grey=3.0))
    drawing.draw(pose(0, 0, 1))
    still = drawing.frame.astype(float)
    rng, differences = np.random.default_rng(3), []
    for _ in range(50):
        drawing.draw(pose(0, 0, 1), rng)
        differences.append((drawing.frame - still)[400:460, 490:550])
    noise = np.array(differences)
    # Rounding to 8 bits adds 1/12 to the variance, a quantised mean up to half a level.
    assert noise.std(axis=0).mean() == pytest.approx(np.sqrt(9 + 1 / 12), rel=0.02)
    centred = noise - noise.mean(axis=0)
    # 180,000 products: the correlation of independent numbers has a deviation of 0.0024, and the
    # means over 50 images, which are taken away, correlate images by -0.02.
    for lag in ((1, 0, 0), (0, 1, 0), (0, 0, 1)):
        product = centred * np.roll(centred, lag, axis=(0, 1, 2))
        assert abs(product.mean()) / centred.var() < 0.03


def test_smear_conserves_light_and_lies_along_its_direction():
    drawing = TargetRenderer(CAMERA, AprilTag(), RENDERING)
    pixels = np.mgrid[: CAMERA.height, : CAMERA.width][::-1]
    sums, variances = [], []
    for smear in ((0.0, 0.0), (9.0, 0.0), (0.0, 9.0)):
        drawing.draw(pose(0, 0, 1.5), smear_px=smear)
        light = drawing.frame.astype(float) - drawing.frame[0, 0]
        sums.append(light.sum())
        mean = (light * pixels).sum(axis=(1, 2)) / light.sum()
        away = pixels - mean[:, None, None]
        variances.append((light * away**2).sum(axis=(1, 2)) / light.sum())
    still, along_u, along_v = variances
    # A box of length s adds s^2 / 12; rounding of the weak tails costs a part.
    assert sums == pytest.approx([sums[0]] * 3, rel=0.02)
    assert along_u - still == pytest.approx([81 / 12, 0], abs=2.0)
    assert along_v - still == pytest.approx([0, 81 / 12], abs=2.0)


def test_impossible_renderings_are_refused():
    for change in [
        {"white_grey": 30.0}, {"background_grey": 220.0}, {"noise_grey": -1.0},
        {"supersampling": 0},
    ]:  # fmt: skip
        refused("rendering", TargetRenderer, CAMERA, AprilTag(), replace(RENDERING, **change))
