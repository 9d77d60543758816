"""A tag's corners against the truth, near and far, and the sigmas against the scatter."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.models.lenses import wide
from tests.vision.poses import pose
from tests.vision.scenes import defocus, jpeg, levels, ramp, rig, rms, scene, shadow, turned
from vergence.models.camera import light_table
from vergence.vision import AprilTag, Camera, Detection, make_detector
from vergence.vision.tag_families import tag_family
from vergence.vision.tags.fit import FitEffort
from vergence.vision.tags.samples import WIDE
from vergence.vision.targets import board_pose

TAG = AprilTag()


def poses(depth_m: float, count: int, seed: int = 0) -> list[np.ndarray]:
    """Near the axis, tilted by up to 30 degrees."""
    rng = np.random.default_rng(seed)
    out = []
    for _ in range(count):
        x, y = rng.uniform(-0.06, 0.06, 2) * depth_m
        out.append(pose(x, y, depth_m, turned(rng, np.radians(30))))
    return out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("depth_m", "name"), [(0.4, "physical"), (1.0, "simulated"), (2.4, "simulated")]
)
def test_corners_and_depth_are_as_exact_as_said(name, depth_m):
    """0.05 px rms of each coordinate with the rig's noise, 0.03 px without; depth to 0.3 %."""
    camera, rendering = rig(name)
    detector, rng = make_detector(TAG, camera), np.random.default_rng(3)
    board = np.column_stack([TAG.corners_m, np.zeros(4)])
    errors, biases, depths = [], [], []
    for T_C_T in poses(depth_m, 8):
        quiet = scene(camera, TAG, T_C_T, rendering)
        biases.append(detector.detect(quiet.image).corners_px - quiet.corners)
        found = detector.detect(scene(camera, TAG, T_C_T, rendering, rng).image)
        errors.append(found.corners_px - quiet.corners)
        _, _, place = cv2.solvePnP(board, found.corners_px, camera.matrix, camera.lens.coefficients)
        depths.append(place[2, 0] / depth_m - 1.0)
    assert rms(errors) < 0.05
    assert rms(biases) < 0.03
    assert rms(depths) < 0.003


@pytest.mark.slow
@pytest.mark.parametrize(("name", "edge_px"), [("simulated", 14.0), ("physical", 17.0)])
def test_small_tags_are_found_at_every_place_in_the_pixel_grid_and_every_roll(name, edge_px):
    """Down to 1.75 px a cell, with the rig's noise; corners to 0.15 px rms."""
    camera, rendering = rig(name)
    detector, rng = make_detector(TAG, camera), np.random.default_rng(5)
    depth_m = TAG.edge_m * camera.focal[0] / edge_px
    errors = []
    for _ in range(12):
        x, y = rng.uniform(-0.1, 0.1, 2) * depth_m
        one = scene(
            camera, TAG, pose(x, y, depth_m, (0, 0, rng.uniform(-3.1, 3.1))), rendering, rng
        )
        found = detector.detect(one.image)
        errors.append(found.corners_px - one.corners)
    assert rms(errors) < 0.15


@pytest.mark.parametrize("left", [0.2, 0.4])
def test_a_shadow_too_deep_blinds_and_does_not_mislead(left):
    """White in the shadow is as dark as black in the sun: what is found all the same is right."""
    camera, rendering = rig("simulated")
    detector, rng = make_detector(TAG, camera), np.random.default_rng(7)
    for depth_m, angle in [(0.5, 0.8), (1.0, 0.0), (2.0, 2.5)]:
        one = scene(camera, TAG, poses(depth_m, 1)[0], rendering, rng)
        found = detector.detect(shadow(left, angle)(one.image, one.point))
        if found is not None:
            assert found.corners_px == pytest.approx(one.corners, abs=0.2)


POOR = {
    "half in shadow near": ("simulated", 1.0, shadow(0.5, 0.0), 0.1),
    "half in shadow far": ("simulated", 2.0, shadow(0.5, 2.5), 0.1),
    "light that falls off": ("simulated", 0.5, ramp(0.2, 0.8, 186.0), 0.1),
    "JPEG of quality 30": ("simulated", 0.8, jpeg(30), 0.15),
    "out of focus": ("physical", 0.8, defocus(1.5), 0.15),
    "a tenth of the light": ("simulated", 0.8, lambda i, m: levels(0.1 * i), 0.25),
    "half shadow and JPEG": ("simulated", 0.8, lambda i, m: jpeg(50)(shadow()(i, m), m), 0.2),
}
"""Rig, depth, change, and the largest rms error; in even light it is 0.05 px."""


@pytest.mark.slow
@pytest.mark.parametrize("what", POOR)
def test_a_poor_image_is_read_and_tracked_and_its_corners_are_right(what):
    name, depth_m, change, most_px = POOR[what]
    camera, rendering = rig(name)
    detector, rng = make_detector(TAG, camera), np.random.default_rng(8)
    errors = []
    for T_C_T in poses(depth_m, 5, seed=2):
        one = scene(camera, TAG, T_C_T, rendering, rng)
        image = change(one.image, one.point)
        found = detector.detect(image)
        assert detector.track(image, found) is not None
        errors.append(found.corners_px - one.corners)
    assert rms(errors) < most_px


@pytest.mark.parametrize(("length_px", "angle"), [(2.0, 0.8), (4.0, 0.0), (4.0, np.pi / 2)])
def test_a_moving_tag_is_at_the_middle_of_its_way(length_px, angle):
    camera, rendering = rig("simulated")
    detector, rng = make_detector(TAG, camera), np.random.default_rng(9)
    smear = length_px * np.array([np.cos(angle), np.sin(angle)])
    errors = []
    for T_C_T in poses(0.8, 5, seed=3):
        one = scene(camera, TAG, T_C_T, rendering, rng, smear)
        found = detector.detect(one.image)
        errors.append(found.corners_px - one.corners)
    assert rms(errors) < 0.15


@pytest.mark.parametrize(
    ("name", "depth_m", "blur_px", "light"),
    [
        ("physical", 0.5, None, None), ("physical", 4.0, None, None), ("simulated", 1.0, 1.5, None),
        pytest.param("simulated", 1.0, None, shadow(), marks=pytest.mark.slow),
    ],
)  # fmt: skip
def test_sigmas_are_the_scatter(name, depth_m, blur_px, light):
    """Mean over the coordinates of 16 images, to 35 %, or more with systematic errors.

    The edge of a sharp shadow, which the levels of blocks do not reveal, moves corners in the same
    way in all images: there the sigmas are no less than the error, and up to 8 times as large.
    """
    camera, rendering = rig(name)
    if blur_px is not None:
        rendering = replace(rendering, blur_px=blur_px)
    detector, rng = make_detector(TAG, camera), np.random.default_rng(10)
    T_C_T = pose(0.0103 * depth_m, 0.0207 * depth_m, depth_m, (0.2, -0.25, 0.15))
    corners, points, said, said_points = [], [], [], []
    one = scene(camera, TAG, T_C_T, rendering)
    truth, true_point = one.corners, one.point
    for _ in range(16):
        one = scene(camera, TAG, T_C_T, rendering, rng)
        image = one.image if light is None else light(one.image, one.point)
        found = detector.detect(image)
        corners.append(found.corners_px)
        points.append(found.point_px)
        said.append(found.corners_sigma_px)
        said_points.append(found.sigma_px)
    for values, true, sigmas in ((corners, truth, said), (points, true_point, said_points)):
        if light is None:
            scatter = rms(np.std(values, axis=0, ddof=1))
            assert 0.65 * scatter < rms(sigmas) < 1.5 * scatter
        else:
            error = rms(np.subtract(values, true))
            assert error < rms(sigmas) < 8.0 * error


@pytest.mark.parametrize(("depth_m", "name"), [(0.5, "physical"), (2.0, "simulated")])
def test_a_gamma_that_nobody_states_moves_no_corner(name, depth_m):
    """Blurred white reaches into black where levels are not proportional to light.

    It does so from both sides of the black border: the cells' edges tell it from a smaller tag.
    """
    camera, rendering = rig(name)
    detector = make_detector(TAG, camera)
    errors, centres = [], []
    for T_C_T in poses(depth_m, 6, seed=4):
        one = scene(camera, TAG, T_C_T, rendering)
        found = detector.detect(levels(255.0 * (one.image / 255.0) ** (1.0 / 2.2)))
        errors.append(found.corners_px - one.corners)
        centres.append(found.point_px - one.point)
    assert rms(errors) < 0.03
    assert rms(centres) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("edge_px", [40.0, 120.0])
def test_sigma_grows_with_the_noise(edge_px):
    """Twice the noise is twice the sigma, but for the rounding's share of it."""
    camera, rendering = rig("simulated")
    detector = make_detector(TAG, camera)
    T_C_T = pose(0.0, 0.0, TAG.edge_m * camera.focal[0] / edge_px, (0.2, 0.1, 0.3))
    said = []
    for noise in (2.0, 4.0, 8.0):
        louder = replace(rendering, noise_grey=noise)
        found = [
            detector.detect(scene(camera, TAG, T_C_T, louder, np.random.default_rng(k)).image)
            for k in range(4)
        ]
        said.append(rms([each.corners_sigma_px for each in found]))
    assert said[1] / said[0] == pytest.approx(2.0, rel=0.25)
    assert said[2] / said[1] == pytest.approx(2.0, rel=0.25)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("lens", "aside_deg"),
    [("fisheye", 35.0), ("fisheye", 60.0), ("rational", 60.0), ("brown-conrady", 40.0)],
)
def test_a_tag_far_off_the_axis_of_a_wide_lens_is_where_it_is(lens, aside_deg):
    """Accuracy equals that straight ahead; the centre is the crossing of the bent diagonals.

    If the lens bends a square too far, a search cannot find it, but tracking can.
    """
    camera = Camera.of(wide(lens), 0)
    _, rendering = rig("physical")
    side = np.deg2rad(aside_deg)
    detector, rng = make_detector(TAG, camera), np.random.default_rng(11)
    bent = lens == "rational" and aside_deg >= 50.0
    errors, centres = [], []
    for k in range(5):
        T_C_T = board_pose(0.5 * np.array([np.sin(side), 0.03 * (k - 2), np.cos(side)]))
        one = scene(camera, TAG, T_C_T @ pose(0, 0, 0, (0, 0, 0.5 * k)), rendering, rng)
        found = detector.detect(one.image)
        if found is None and bent:
            sigmas = np.full((4, 2), 0.1)
            near = Detection(TAG, one.point, one.corners + 0.7, sigmas[0], sigmas)
            found = detector.track(one.image, near)
        errors.append(found.corners_px - one.corners)
        centres.append(found.point_px - one.point)
    assert rms(errors) < (0.1 if bent else 0.06)
    assert rms(centres) < 0.04


@pytest.mark.nightly
def test_a_tag_with_a_side_that_something_covers_is_seldom_found_beside_its_place():
    """A straight edge across its corner, in 60 images.

    It is the one known way to be misled: what is left of the side may fit a square that is
    narrower on that side by less than a cell.
    """
    camera, rendering = rig("simulated")
    one = scene(camera, TAG, pose(0.0, 0.0, 0.5), rendering)
    cell_px = np.linalg.norm(one.corners[1] - one.corners[0]) / 8.0
    v, u = np.indices(one.image.shape)
    beside = 0
    for angle in np.arange(0.2, 6.2, 0.6):
        x, y = np.cos(angle), np.sin(angle)
        for cells in (0.8, 1.05, 1.3):
            end = (one.corners @ (x, y)).max() - cells * cell_px
            for grey in (90, 120):
                image = np.where(u * x + v * y > end, grey, one.image).astype(np.uint8)
                found = make_detector(TAG, camera).detect(image)
                if found is not None:
                    beside += np.abs(found.corners_px - one.corners).max() > 0.5
    assert beside <= 2


@pytest.mark.slow
def test_edges_are_fitted_in_the_light_that_levels_stand_for():
    """By the levels as they are a blurred edge is no Gaussian's, and sigma says so."""
    camera, rendering = rig("simulated")
    detector = make_detector(TAG, replace(camera, response="srgb"))
    levels_of_light = np.rint(
        np.interp(np.arange(256), light_table("srgb"), np.arange(256))
    ).astype(np.uint8)
    errors, sigmas, unaware = [], [], []
    for T_C_T in poses(1.0, 6):
        drawn = scene(camera, TAG, T_C_T, rendering, np.random.default_rng(3))
        image = levels_of_light[drawn.image]
        found = detector.detect(image)
        errors.append(found.corners_px - drawn.corners)
        sigmas.append(found.corners_sigma_px)
        unaware.append(make_detector(TAG, camera).detect(image).corners_sigma_px)
    assert rms(errors) < 0.04
    assert 0.5 < rms(np.array(errors) / np.array(sigmas)) < 1.5
    assert rms(unaware) > 1.1 * rms(sigmas)


@pytest.mark.parametrize("number", [1, 4, 13])
def test_black_that_blur_makes_lighter_than_midway_in_grey_levels_is_read(number):
    """In light it is nearer to black: a row of cells 3.4 px high is smeared over 4.2 px."""
    cells = np.pad(tag_family("36h11").cells(number)[1:-1, 1:-1], 3, constant_values=255)
    fine = np.kron(np.where(cells > 0, 110.0, 1.0), np.ones((34, 34)))[:470, :470]
    light = cv2.GaussianBlur(cv2.blur(fine, (1, 42)), (0, 0), 3)[5::10, 5::10]
    image = np.rint(np.interp(light, light_table("srgb"), np.arange(256))).astype(np.uint8)
    detector = make_detector(AprilTag(id=number), response="srgb")
    assert detector.detect(image) is not None


@pytest.mark.slow
def test_clipped_white_counts_for_nothing():
    """Depth by PnP, which a fifth too much light makes larger by 0.6 % where white counts."""
    camera, rendering = rig("simulated")
    detector, rng = make_detector(TAG, camera), np.random.default_rng(3)
    board = np.column_stack([TAG.corners_m, np.zeros(4)])
    depths = []
    for T_C_T in poses(0.7, 10):
        drawn = scene(camera, TAG, T_C_T, rendering, rng)
        found = detector.detect(levels(drawn.image * (1.2 * 255.0 / rendering.white_grey)))
        lens = camera.lens.coefficients
        _, _, place = cv2.solvePnP(board, found.corners_px, camera.matrix, lens)
        depths.append(100.0 * (place[2, 0] / 0.7 - 1.0))
    assert rms(depths) < 0.2


@pytest.mark.parametrize("edge_px", [50.0, 150.0])
def test_sigma_is_that_of_the_error_whatever_pixels_take_part(edge_px):
    """Residuals that are alike from pixel to pixel are no more certain for being many."""
    camera, rendering = rig("simulated")
    detector, rng = make_detector(TAG, camera), np.random.default_rng(3)
    depth_m = TAG.edge_m * camera.focal[0] / edge_px
    shares = {240: [], 800: [], 4000: []}
    for T_C_T in poses(depth_m, 10):
        drawn = scene(camera, TAG, T_C_T, rendering, rng)
        image = jpeg(70)(drawn.image, drawn.point)
        for most, share in shares.items():
            found, _ = detector._fit_once(
                detector._frame(image), drawn.corners, TAG.id, FitEffort(WIDE, 3, 8, 200, most)
            )
            share.append((found.corners_px - drawn.corners) / found.corners_sigma_px)
    for share in shares.values():
        assert 0.6 < rms(share) < 1.6
