"""A point at rest from several fixations, and the predicted spread of the gap of a single one."""

import numpy as np
import pytest

import vergence
from vergence.calibration.head.simulated import quantised
from vergence.errors import ConfigurationError
from vergence.models.parts import EYES
from vergence.triangulation import Noise, gap_sigma, triangulate_fixations, triangulate_views

FIXATIONS = 64
NOISE = Noise(pixel_px=0.05)
POINTS = np.array([[0.0, -0.1, 1.0], [0.2, 0.05, 0.6], [-0.3, 0.1, 2.0]])


def looked_at(head, point, rng):
    """Readings and pixels of fixations whose angles differ by up to 0.3 degrees."""
    own = head.actuation
    angles = np.tile(own.actuators_of(head.fixate(point)), (FIXATIONS, 1))
    angles[:, 3:] += rng.uniform(-0.005, 0.005, (FIXATIONS, 4)) * (own.upper > own.lower)[3:]
    q = own.joints_of(angles)
    pixels = head.project(q, point) + 0.05 * rng.standard_normal((FIXATIONS, 2, 2))
    return quantised(head, q), pixels


@pytest.mark.slow
@pytest.mark.parametrize("name", ["physical", "icub"])
def test_points_are_as_sure_as_they_are_said_to_be_and_surer_than_a_mean(name):
    head, rng = vergence.load_head(name), np.random.default_rng(1)
    squares, errors, means = [], [], []
    for point in rng.uniform([-0.2, -0.1, 0.6], [0.2, 0.1, 2.0], (40, 3)):
        q, pixels = looked_at(head, point, rng)
        fix = triangulate_fixations(head, q, pixels, NOISE)
        error = fix.point - point
        squares.append(error @ np.linalg.solve(fix.covariance, error) / 3.0)
        errors.append(error[2] / point[2])
        means.append(triangulate_views(head, q, pixels).point[:, 2].mean() / point[2] - 1.0)
    # of 120 numbers, the mean square deviates by 0.13
    assert 0.6 < np.mean(squares) < 1.4
    assert np.std(errors) < np.std(means)


def test_exact_encoders_and_pixels_give_the_point():
    head = vergence.load_head("simulated")
    point = np.array([0.1, -0.05, 1.2])
    q = head.fixate(point + [[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.0, 0.01, 0.1]])
    fix = triangulate_fixations(head, q, head.project(q, point))
    np.testing.assert_allclose(fix.point, point, atol=1e-7)


def test_fixations_in_which_an_eye_sees_nothing_do_not_count():
    head = vergence.load_head("physical")
    point = np.array([0.0, 0.0, 1.0])
    q, pixels = looked_at(head, point, np.random.default_rng(2))
    blind = pixels.copy()
    blind[40:, 1] = np.nan
    first = triangulate_fixations(head, q[:40], pixels[:40], NOISE)
    assert np.array_equal(triangulate_fixations(head, q, blind, NOISE).point, first.point)
    with pytest.raises(ConfigurationError, match="both eyes see the point, got none in 64"):
        triangulate_fixations(head, q, np.full_like(pixels, np.nan), NOISE)


@pytest.mark.parametrize("name", ["simulated", "icub"])
def test_gaps_of_noisy_views_have_the_predicted_spread(name):
    head, rng = vergence.load_head(name), np.random.default_rng(0)
    noise, samples = Noise(pixel_px=0.4, joint_rad=3e-4), 4000
    q = np.broadcast_to(head.rest(), (len(POINTS), 7))
    pixels = head.project(q, POINTS)
    seen = np.isfinite(pixels).all(axis=(1, 2))
    assert seen.sum() >= 2
    q, pixels = q[seen], pixels[seen]
    errors = np.zeros((samples, 1, 7))
    count = head.actuation.count
    errors[..., EYES.start : EYES.start + count] = rng.normal(0.0, 3e-4, (samples, 1, count))
    read = head.actuation.joints_of(head.actuation.actuators_of(q) + errors)
    found = pixels + rng.normal(0.0, 0.4, (samples, *pixels.shape))
    gaps = triangulate_views(head, read, found).gap
    measured = np.sqrt((gaps**2).mean(axis=0))
    # a standard deviation of 4,000 samples is known to 1.1 %
    assert measured == pytest.approx(gap_sigma(head, q, pixels, noise), rel=0.05)


def test_without_noise_nothing_is_spread_and_an_eye_without_the_target_has_no_gap():
    head = vergence.load_head("simulated")
    pixels = head.project(head.rest(), POINTS)
    assert not gap_sigma(head, head.rest(), pixels, Noise()).any()
    pixels[1, 0] = np.nan
    sigma = gap_sigma(head, head.rest(), pixels)
    assert np.isfinite(sigma).tolist() == [True, False, True]
