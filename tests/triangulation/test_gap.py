"""The predicted spread of the gap, against gaps of noisy pixels and joints."""

import numpy as np
import pytest

from vergence import Noise, load_head, triangulate_views
from vergence.models.parts import EYES
from vergence.triangulation.fix import gap_sigma

POINTS = np.array([[0.0, -0.1, 1.0], [0.2, 0.05, 0.6], [-0.3, 0.1, 2.0]])


@pytest.mark.parametrize("name", ["simulated", "icub"])
def test_gaps_of_noisy_views_have_the_predicted_spread(name):
    head, rng = load_head(name), np.random.default_rng(0)
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
    head = load_head("simulated")
    pixels = head.project(head.rest(), POINTS)
    assert not gap_sigma(head, head.rest(), pixels, Noise()).any()
    pixels[1, 0] = np.nan
    sigma = gap_sigma(head, head.rest(), pixels)
    assert np.isfinite(sigma).tolist() == [True, False, True]
