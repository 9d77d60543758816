"""The propagated covariance C against the sample covariance S of many draws.

All eigenvalues of inv(S) C lie within 0.94 to 1.06: for 20,000 normal draws in three dimensions
those of the sampling itself reach about 1 +- 3 sqrt(2 / 20000) = 1 +- 0.03, and the rest is left
for the second order, which grows with depth.
"""

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.models.lenses import LENSES, wide
from tests.naming import named
from tests.triangulation.conftest import settled_angles
from vergence import HeadModel, Noise, triangulate_gaze, triangulate_views

DRAWS = 20_000
PIXEL_PX = 0.05
JOINT_RAD = 1e-4

Array = NDArray[np.float64]


def point_at(depth: float, aside_deg: float) -> Array:
    return np.array([depth * np.tan(np.deg2rad(aside_deg)), -0.1, depth])


def eigenvalues(propagated: Array, sample: Array) -> Array:
    return np.sort(np.linalg.eigvals(np.linalg.solve(sample, propagated)).real)


def agree(propagated: Array, draws: Array) -> bool:
    low, _, high = eigenvalues(propagated, np.cov(draws.T))
    return low > 0.94 and high < 1.06


@pytest.fixture(params=[(0.5, 25.0), (2.5, 0.0)], ids=["near and aside", "far and ahead"])
def point(request: pytest.FixtureRequest) -> Array:
    return point_at(*request.param)


def test_noise_of_views(head: HeadModel, point, rng) -> None:
    # the eyes look beside the target, so that the interaction of both axes counts
    q = head.fixate(point + [0.05, 0.05, 0.0])
    pixels = head.project(q, point)
    seen = pixels + PIXEL_PX * rng.standard_normal((DRAWS, 2, 2))
    fix = triangulate_views(head, q, pixels, Noise(pixel_px=PIXEL_PX))
    assert agree(fix.covariance, triangulate_views(head, q, seen, Noise()).point)
    draws = q + JOINT_RAD * rng.standard_normal((DRAWS, 7))
    fix = triangulate_views(head, q, pixels, Noise(joint_rad=JOINT_RAD))
    assert agree(fix.covariance, triangulate_views(head, draws, pixels, Noise()).point)


def test_joint_noise_of_gaze(head: HeadModel, point, rng) -> None:
    q = head.fixate(point)
    draws = q + JOINT_RAD * rng.standard_normal((DRAWS, 7))
    fix = triangulate_gaze(head, q, Noise(joint_rad=JOINT_RAD))
    assert agree(fix.covariance, triangulate_gaze(head, draws, Noise()).point)


@pytest.mark.slow
def test_pixel_noise_of_gaze_reaches_the_point_through_the_settled_loop(
    head: HeadModel, point, rng
) -> None:
    q = head.fixate(point)
    draws = settled_angles(
        head,
        head,
        np.broadcast_to(point, (DRAWS, 3)),
        PIXEL_PX * rng.standard_normal((DRAWS, 2, 2)),
    )
    fix = triangulate_gaze(head, q, Noise(pixel_px=PIXEL_PX))
    assert agree(fix.covariance, triangulate_gaze(head, draws, Noise()).point)


@pytest.mark.parametrize(("right", "left"), [("fisheye", "rational"), ("brown-conrady", "fisheye")])
def test_pixel_noise_of_views_through_any_lens(left, right, rng) -> None:
    head = wide(left, right)
    point = np.array([0.35, -0.25, 0.6])  # 30 to 40 degrees aside
    q = np.array([0.0, 0.0, 0.0, 0.05, -0.05, 0.0, 0.05])
    pixels = head.project(q, point)
    draws = pixels + PIXEL_PX * rng.standard_normal((DRAWS, 2, 2))
    fix = triangulate_views(head, q, pixels, Noise(pixel_px=PIXEL_PX))
    assert np.abs(fix.point - point).max() < 1e-9
    assert agree(fix.covariance, triangulate_views(head, q, draws, Noise()).point)


def test_the_covariance_is_that_of_a_fixs_derivative_by_each_pixel() -> None:
    for lens in LENSES:
        with named(lens):
            head = wide(lens)
            point = np.array([-0.3, 0.2, 0.5])
            q = np.array([0.0, 0.0, 0.0, 0.1, 0.05, 0.1, -0.05])
            pixels = head.project(q, point)
            step = 1e-4
            nudges = step * np.eye(4).reshape(4, 2, 2)
            plus = triangulate_views(head, q, pixels + nudges, Noise()).point
            minus = triangulate_views(head, q, pixels - nudges, Noise()).point
            by_pixel = (plus - minus) / (2.0 * step)
            expected = PIXEL_PX**2 * np.einsum("ni,nj->ij", by_pixel, by_pixel)
            covariance = triangulate_views(head, q, pixels, Noise(pixel_px=PIXEL_PX)).covariance
            np.testing.assert_allclose(covariance, expected, rtol=1e-6, atol=1e-6 * expected.max())


def ratios_of_equations_27_to_30(head: HeadModel, aside_deg: float) -> Array:
    """Variances of the loop, over those if a pixel turned tilt and pan by arctan(1 / f) each."""
    q = head.fixate(point_at(1.0, aside_deg))
    sigma = np.zeros(7)
    sigma[[4, 3, 6, 5]] = PIXEL_PX / head.cameras.focal.ravel()  # u is pan's and v is tilt's
    article = triangulate_gaze(head, q, Noise(joint_rad=sigma)).covariance
    return eigenvalues(article, triangulate_gaze(head, q, Noise(pixel_px=PIXEL_PX)).covariance)


def test_equations_27_to_30_hold_straight_ahead(simulated: HeadModel) -> None:
    # Both pans are within 3 degrees at 1 m and the tilt of the axes is 4: a few per mille.
    assert ratios_of_equations_27_to_30(simulated, 0.0) == pytest.approx(np.ones(3), abs=0.02)


def test_equations_27_to_30_underestimate_height_aside_by_the_squared_cosine(
    simulated: HeadModel,
) -> None:
    """An eye panned by phi and tilted by 1 rad turns its axis by cos(phi) only.

    So to move the image of a target by a pixel vertically the tilt must turn by 1 / (f cos phi),
    and the point rises and falls with that. Equation 28 takes 1 / f, so its variance of height
    is too small by cos^2 phi; in the plane of the two axes, which pan alone moves, the two agree.
    """
    expected = [np.cos(np.deg2rad(25.0)) ** 2, 1.0, 1.0]
    assert ratios_of_equations_27_to_30(simulated, 25.0) == pytest.approx(expected, abs=0.02)
