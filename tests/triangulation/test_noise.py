"""Noise of a fix's inputs; joints that one actuator moves have one error, not two."""

import numpy as np
import pytest

from tests.heads import head_of
from tests.naming import named
from vergence import HeadModel, Noise, triangulate_gaze, triangulate_views
from vergence.errors import ConfigurationError

POINT = np.array([0.1, -0.1, 1.0])
NEAR = np.array([0.05, -0.1, 0.7])
DRAWS = 40_000
SIGMA = np.array([0.0, 0.0, 0.0, 3e-4, 6e-4, 2e-4, 0.0])


def test_noise_of_a_head_is_that_of_its_sensors_and_the_default(head: HeadModel) -> None:
    noise = Noise.of(head)
    assert np.all(noise.pixel_px == head.sensor.detection_noise_px)
    # what an even spread over one step has
    assert np.all(noise.joint_rad == head.sensor.encoder_resolution_rad / np.sqrt(12.0))
    q = head.fixate(POINT)
    of_head = triangulate_gaze(head, q, noise).covariance
    assert np.array_equal(triangulate_gaze(head, q).covariance, of_head)


def test_independent_sources_add_their_covariances_and_the_necks_adds_none(head) -> None:
    q = head.fixate(POINT)
    pixels = head.project(q, POINT)
    sources = ({"pixel_px": 0.05}, {"joint_rad": [0.0, 0.0, 0.0, 1e-4, 1e-4, 1e-4, 1e-4]})
    parts = [triangulate_views(head, q, pixels, Noise(**source)).covariance for source in sources]
    both = triangulate_views(head, q, pixels, Noise(pixel_px=0.05, joint_rad=1e-4))
    assert both.covariance == pytest.approx(sum(parts), rel=1e-12)
    assert both.sigma == pytest.approx(np.sqrt(np.diag(both.covariance)), rel=1e-15)
    still = triangulate_gaze(head, q, Noise(joint_rad=[0.1, 0.1, 0.1, 0.0, 0.0, 0.0, 0.0]))
    assert still.valid
    assert not still.covariance.any()


def test_depth_noise_grows_with_the_square_of_depth_over_the_baseline(head: HeadModel) -> None:
    # Straight ahead of the middle between the eyes sigma_z is Z^2 / b times the angle's.
    middle = head.camera_poses(np.zeros(7))[:, :3, 3].mean(axis=0)
    for z in (1.0, 2.0):
        q = head.fixate(middle + [0.0, 0.0, z])
        noise = Noise(joint_rad=[0.0, 0.0, 0.0, 0.0, 1e-4, 0.0, 1e-4])
        sigma_z = triangulate_gaze(head, q, noise).sigma[2]
        expected = (z**2 + 0.046**2) / 0.092 * 1e-4 * np.sqrt(2.0)
        # the optical centre turns 30 mm beside its pan axis' foot: per mille at these depths
        assert sigma_z == pytest.approx(expected, rel=5e-3)


def test_noise_that_cannot_be_is_refused_by_name() -> None:
    for key, value, expected in (
        ("pixel_px", -0.1, ">= 0"),
        ("pixel_px", np.nan, "finite"),
        ("joint_rad", np.inf, "finite"),
        ("pixel_px", np.ones((2, 3)), r"\(\.\.\., 2, 2\)"),
        ("joint_rad", np.ones(4), r"\(\.\.\., 7\)"),
        ("joint_rad", "large", "large"),
    ):
        said = rf"Noise\.{key}: expected .*{expected}"
        with named(key, value), pytest.raises(ConfigurationError, match=said):
            Noise(**{key: value})


def test_the_covariance_is_that_of_draws_of_the_actuators():
    for name in ("tied", "mis", "panfirst"):
        with named(name):
            head = head_of(name)
            sigma = np.where(head.actuation.velocity > 0.0, SIGMA, 0.0)
            own = head.actuation.actuators_of(head.fixate(NEAR))
            noise = np.random.default_rng(0).normal(size=(DRAWS, 7)) * sigma
            drawn = triangulate_gaze(head, head.actuation.joints_of(own + noise), Noise()).point
            expected = triangulate_gaze(head, head.fixate(NEAR), Noise(joint_rad=sigma)).covariance
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
    q = head.fixate(NEAR)
    lean = np.zeros((4000, 7))
    lean[:, 3:6] = 0.001 * rng.choice([-1.0, 1.0], (4000, 3))
    true = head.actuation.joints_of(head.actuation.actuators_of(q) + lean)
    fixes = triangulate_views(head, q, head.project(true, NEAR), Noise(joint_rad=0.0))
    told = triangulate_views(
        head, q, head.project(q, NEAR), Noise(joint_rad=Noise.of(head).joint_rad)
    )
    scatter = np.cov(fixes.point.T)
    assert np.diag(scatter) == pytest.approx(np.diag(told.covariance), rel=0.15)


def test_a_fixed_pair_locates_by_its_images_and_not_by_gaze():
    head = head_of("pair")
    pixels = head.project(np.zeros(7), NEAR)
    fix = triangulate_views(head, np.zeros(7), pixels)
    assert fix.point == pytest.approx(NEAR, abs=1e-9)
    by_pixels = triangulate_views(head, np.zeros(7), pixels, Noise(pixel_px=0.05)).covariance
    assert fix.covariance == pytest.approx(by_pixels, rel=1e-12)
    with pytest.raises(ConfigurationError, match=r"triangulate_gaze: .*'pair', a fixed pair: tri"):
        triangulate_gaze(head, np.zeros(7))
