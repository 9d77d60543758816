"""The noise of joints that one actuator moves: one error, not two."""

import numpy as np
import pytest

from tests.heads import head_of
from tests.naming import named
from vergence.errors import ConfigurationError
from vergence.triangulation import Noise, triangulate_gaze, triangulate_views

POINT = np.array([0.05, -0.1, 0.7])
DRAWS = 40_000
SIGMA = np.array([0.0, 0.0, 0.0, 3e-4, 6e-4, 2e-4, 0.0])


def test_the_covariance_is_that_of_draws_of_the_actuators():
    for name in ("tied", "mis", "panfirst"):
        with named(name):
            head = head_of(name)
            sigma = np.where(head.actuation.velocity > 0.0, SIGMA, 0.0)
            own = head.actuation.actuators_of(head.fixate(POINT))
            noise = np.random.default_rng(0).normal(size=(DRAWS, 7)) * sigma
            drawn = triangulate_gaze(head, head.actuation.joints_of(own + noise), Noise()).point
            expected = triangulate_gaze(head, head.fixate(POINT), Noise(joint_rad=sigma)).covariance
            # 40,000 draws leave 0.7 % of a variance, and first order some more
            scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
            assert np.abs(np.cov(drawn.T) - expected).max() < (0.03 * scale).max()


def test_an_error_of_the_vergence_is_one_of_depth_and_one_of_the_version_is_not():
    head = head_of("tied")
    q = head.fixate([0.0, 0.0, 0.7])
    sigmas = {
        name: triangulate_gaze(head, q, Noise(joint_rad=1e-3 * np.eye(7)[3 + i])).sigma
        for i, name in enumerate(head.actuation.names)
    }
    assert sigmas["vergence"][2] > 100.0 * sigmas["vergence"][:2].max()
    assert sigmas["version"][0] > 100.0 * sigmas["version"][2]


def test_the_noise_of_a_head_is_that_of_each_actuators_own_encoder_and_play():
    steps, plays = np.array([1e-3, 2e-3, 3e-3]), np.array([0.0, 0.01, 0.02])
    head = head_of("mis")
    of_head = head.sensor.encoder_resolution_rad
    own = head.replace(actuators={"encoder_resolution_rad": steps})
    expected = np.array([of_head] * 3 + [*steps, 0.0]) / np.sqrt(12.0)
    assert Noise.of(own).joint_rad == pytest.approx(expected)
    # play leaves what is driven on either side of its encoder
    loose = own.replace(actuators={"backlash_rad": plays})
    expected = np.sqrt(steps**2 / 12.0 + (0.5 * plays) ** 2)
    assert Noise.of(loose).joint_rad[3:6] == pytest.approx(expected)


def test_a_gaze_with_play_is_as_wrong_as_its_covariance_says():
    rng = np.random.default_rng(3)
    head = head_of("tied").replace(
        actuators={"encoder_resolution_rad": [0.0] * 3, "backlash_rad": [0.002] * 3}
    )
    q = head.fixate(POINT)
    lean = np.zeros((4000, 7))
    lean[:, 3:6] = 0.001 * rng.choice([-1.0, 1.0], (4000, 3))
    true = head.actuation.joints_of(head.actuation.actuators_of(q) + lean)
    fixes = triangulate_views(head, q, head.project(true, POINT), Noise(joint_rad=0.0))
    told = triangulate_views(
        head, q, head.project(q, POINT), Noise(joint_rad=Noise.of(head).joint_rad)
    )
    scatter = np.cov(fixes.point.T)
    assert np.diag(scatter) == pytest.approx(np.diag(told.covariance), rel=0.15)


def test_a_fixed_pair_locates_by_its_images_and_not_by_gaze():
    head = head_of("pair")
    pixels = head.project(np.zeros(7), POINT)
    fix = triangulate_views(head, np.zeros(7), pixels)
    assert fix.point == pytest.approx(POINT, abs=1e-9)
    by_pixels = triangulate_views(head, np.zeros(7), pixels, Noise(pixel_px=0.05)).covariance
    assert fix.covariance == pytest.approx(by_pixels, rel=1e-12)
    with pytest.raises(ConfigurationError, match=r"triangulate_gaze: .*'pair', a fixed pair: tri"):
        triangulate_gaze(head, np.zeros(7))
