"""Lens models: OpenCV's numbers, there and back, derivatives, and nan where a model folds back."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.grids import some_of
from tests.models.lenses import COEFFICIENTS, LENSES, wide
from tests.naming import named
from vergence.models.camera import Camera, pixels_to_rays, rays_to_pixels
from vergence.models.lens import camera_at, distort, pack_camera

FOLDS = {  # by the first radial coefficient, or those of a quotient, and r where it turns back
    # r (1 - 0.3 r^2) at r^2 = 1 / 0.9
    "brown-conrady": ((-0.3, 0.0, 0.0, 0.0, 0.0), 1.0 / np.sqrt(0.9)),
    # r / (1 + r^2 / 3) at r^2 = 3
    "rational": ((0.0, 0.0, 0.0, 0.0, 0.0, 1.0 / 3.0, 0.0, 0.0), np.sqrt(3.0)),
    # t (1 - 0.3 t^2) at t^2 = 1 / 0.9, and r is its tangent
    "fisheye": ((-0.3, 0.0, 0.0, 0.0), np.tan(1.0 / np.sqrt(0.9))),
}


def row_of(lens, coefficients, size=(1000, 800), focal=500.0):
    centre = (np.array(size) - 1.0) / 2.0
    return pack_camera(size, np.full(2, focal), centre, lens, np.array(coefficients))


def spread_rays(rng, count, most_deg=89.0):
    """(count, 2) rays (X / Z, Y / Z) at angles up to one from the axis."""
    angle = np.deg2rad(rng.uniform(0.0, most_deg, count))
    turn = rng.uniform(0.0, 2.0 * np.pi, count)
    return np.tan(angle)[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)


def by_opencv(camera: Camera, in_camera: np.ndarray) -> np.ndarray:
    """(n, 2) where OpenCV's own function sees points (n, 3) of the camera frame, px."""
    model, coefficients = camera.lens
    project = cv2.fisheye.projectPoints if model == "fisheye" else cv2.projectPoints
    zero = np.zeros(3)
    pixels, _ = project(in_camera[:, None], zero, zero, camera.matrix, np.array(coefficients))
    return pixels.reshape(-1, 2)


def pixels_of_image(camera: Camera, count: int = 60) -> np.ndarray:
    """(count^2, 2) pixels over all of an image, its edge among them."""
    u, v = (np.linspace(-0.5, length - 0.5, count) for length in camera.size)
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)


def test_projection_is_opencvs_and_leads_there_and_back_over_the_whole_image(rng):
    for right, left in some_of(LENSES, LENSES):
        with named(right, left):
            head = wide(left, right)
            rays, rest = spread_rays(rng, 2000), np.zeros(7)
            points = rng.uniform([-0.5, -0.4, 0.4], [0.5, 0.4, 1.0], (100, 3))
            seen, to_cameras = head.project(rest, points), np.linalg.inv(head.camera_poses(rest))
            ideal = head.undistort(np.stack([*map(pixels_of_image, head.cameras)], axis=1))
            for eye, (camera, pose) in enumerate(zip(head.cameras, to_cameras, strict=True)):
                pixels = rays_to_pixels(rays, camera.row)
                inside = ((pixels >= -0.5) & (pixels <= np.array(camera.size) - 0.5)).all(axis=-1)
                assert inside.mean() > 0.5
                expected = by_opencv(camera, np.insert(rays[inside], 2, 1.0, axis=1))
                # rounding of pixels
                assert np.abs(pixels[inside] - expected).max() < 1e-9
                expected = by_opencv(camera, points @ pose[:3, :3].T + pose[:3, 3])
                assert np.abs(seen[:, eye] - expected).max() < 1e-9
                raw = pixels_of_image(camera)
                back = pixels_to_rays(raw, camera.row)
                has_ray = np.isfinite(back).all(axis=-1)
                assert has_ray.mean() > 0.95
                assert np.abs(rays_to_pixels(back[has_ray], camera.row) - raw[has_ray]).max() < 1e-9
                pinhole = camera.principal + camera.focal * back
                np.testing.assert_allclose(ideal[:, eye], pinhole, rtol=1e-12, atol=1e-9)


def test_the_derivative_is_that_of_finite_differences_and_symmetric(rng):
    step = 1e-6
    for lens in LENSES:
        camera = camera_at(row_of(lens, COEFFICIENTS[lens]), 0)
        for x, y in [*spread_rays(rng, 50, 55.0), (0.0, 0.0), (1e-9, -1e-9), (0.0, 0.5)]:
            bent = distort(camera, x, y)
            for derivative, dx, dy in (
                ([bent.dxx, bent.dxy], step, 0.0), ([bent.dxy, bent.dyy], 0.0, step),
            ):  # fmt: skip
                after, before = distort(camera, x + dx, y + dy), distort(camera, x - dx, y - dy)
                slope = np.array([after.x - before.x, after.y - before.y]) / (2.0 * step)
                # central differences of functions of size 1: 1e-16 / 1e-6 of rounding, 1e-12 of
                # curvature
                with named(lens, x, y):
                    assert derivative == pytest.approx(slope, abs=1e-9)


def test_a_ray_beyond_the_fold_has_no_pixel_and_a_pixel_beyond_it_no_ray():
    turn = np.linspace(0.0, 2.0 * np.pi, 25)
    around, centre = np.stack([np.cos(turn), np.sin(turn)], axis=-1), np.array([499.5, 399.5])
    for lens, (coefficients, fold) in FOLDS.items():
        with named(lens):
            row = row_of(lens, coefficients)
            edge = rays_to_pixels(0.999999 * fold * around, row)
            rim = np.linalg.norm(edge - centre, axis=-1)[:, None] * around
            assert np.isfinite(rays_to_pixels(0.999 * fold * around, row)).all()
            assert np.isfinite(pixels_to_rays(centre + 0.999 * rim, row)).all()
            for beyond in (1.001, 1.5, 20.0):
                assert np.isnan(rays_to_pixels(beyond * fold * around, row)).all()
                assert np.isnan(pixels_to_rays(centre + beyond * rim, row)).all()
            row = row_of(lens, COEFFICIENTS[lens])
            for nowhere in ([np.nan, np.nan], [1e20, 0.0], [-1e15, 1e15]):
                assert np.isnan(pixels_to_rays(np.array(nowhere), row)).all()


def test_where_the_image_ends_without_a_radial_fold():
    for lens, coefficients, inside, outside, why in [
        ("rational", (0.0, 0.0, 0.0, 0.0, 0.0, -0.25, 0.0, 0.0), 1.9999, 2.0001,
         "r / (1 - r^2 / 4) rises to infinity at r = 2, and comes back from below"),
        ("brown-conrady", (0.0, 0.0, 0.0, 0.1, 0.0), -1.66, -1.67,
         "the derivative along x at (x, 0) is 1 + 6 p2 x: zero at x = -1 / (6 p2)"),
    ]:  # fmt: skip
        row = row_of(lens, coefficients)
        with named(why):
            assert np.isfinite(rays_to_pixels(np.array([inside, 0.0]), row)).all()
            assert np.isnan(rays_to_pixels(np.array([outside, 0.0]), row)).all()
            for ray in (1.0, 0.95 * abs(inside), 0.995 * abs(inside)):
                pixel = rays_to_pixels(np.array([ray, 0.0]), row)
                assert pixels_to_rays(pixel, row) == pytest.approx([ray, 0.0], rel=1e-12, abs=1e-15)
    # an ideal pinhole shows nothing at a right angle
    row, rim = row_of("fisheye", (0.0, 0.0, 0.0, 0.0)), 499.5 + 500.0 * np.pi / 2.0
    assert np.isfinite(pixels_to_rays(np.array([rim - 1e-3, 399.5]), row)).all()
    assert np.isnan(pixels_to_rays(np.array([rim + 1e-3, 399.5]), row)).all()


RADIAL, TANGENTIAL = st.floats(-2.0, 2.0), st.floats(-0.01, 0.01)
FIVE = [RADIAL, RADIAL, TANGENTIAL, TANGENTIAL, RADIAL]
PARTS = {"brown-conrady": FIVE, "rational": [*FIVE, *[RADIAL] * 3], "fisheye": [RADIAL] * 4}
ANY_LENS = st.one_of([st.tuples(st.just(lens), st.tuples(*PARTS[lens])) for lens in LENSES])


@settings(max_examples=60)
@given(drawn=ANY_LENS, u=st.floats(-0.5, 999.5), v=st.floats(-0.5, 799.5))
def test_every_pixel_of_any_lens_has_its_ray_or_none(drawn, u, v):
    row = row_of(*drawn)
    ray = pixels_to_rays(np.array([u, v]), row)
    if np.isfinite(ray).all():
        assert np.abs(rays_to_pixels(ray, row) - [u, v]).max() < 1e-9


@settings(max_examples=60)
@given(drawn=ANY_LENS, radius=st.floats(0.0, 0.9), turn=st.floats(0.0, 6.3))
def test_every_ray_well_inside_the_fold_of_any_lens_is_found_again(drawn, radius, turn):
    row = row_of(*drawn)
    ray = radius * min(np.sqrt(row[15]), 2.0) * np.array([np.cos(turn), np.sin(turn)])
    pixel = rays_to_pixels(ray, row)
    bent = distort(camera_at(row, 0), *ray)
    # where the image hardly moves with the ray, rounding of the pixel moves the ray
    if np.isfinite(pixel).all() and bent.dxx * bent.dyy - bent.dxy**2 > 1e-2:
        assert np.abs(pixels_to_rays(pixel, row) - ray).max() < 1e-9
