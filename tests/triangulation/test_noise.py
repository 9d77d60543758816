"""Noise of a fix's inputs."""

import numpy as np
import pytest

from tests.naming import named
from vergence import HeadModel, Noise, triangulate_gaze, triangulate_views
from vergence.errors import ConfigurationError

POINT = np.array([0.1, -0.1, 1.0])


def test_noise_of_a_head_is_that_of_its_sensors_and_the_default(head: HeadModel) -> None:
    noise = Noise.of(head)
    assert np.all(noise.pixel_px == head.sensor.detection_noise_px)
    # what an even spread over one step has
    assert np.all(noise.joint_rad == head.sensor.encoder_resolution_rad / np.sqrt(12.0))
    q = head.fixate(POINT)
    of_head = triangulate_gaze(head, q, noise).covariance
    assert np.array_equal(triangulate_gaze(head, q).covariance, of_head)


def test_sigma_is_the_root_of_the_diagonal_and_none_without_noise(head: HeadModel) -> None:
    fix = triangulate_gaze(head, head.fixate(POINT), Noise(pixel_px=0.1))
    assert fix.sigma == pytest.approx([fix.covariance[i, i] ** 0.5 for i in range(3)], rel=1e-15)
    still = triangulate_gaze(head, head.fixate(POINT), Noise())
    assert still.valid
    assert not still.covariance.any()


def test_independent_sources_add_their_covariances(head: HeadModel) -> None:
    q = head.fixate(POINT)
    pixels = head.project(q, POINT)
    parts = [
        triangulate_views(head, q, pixels, noise).covariance
        for noise in (Noise(pixel_px=0.05), Noise(joint_rad=1e-4))
    ]
    both = triangulate_views(head, q, pixels, Noise(pixel_px=0.05, joint_rad=1e-4)).covariance
    assert both == pytest.approx(sum(parts), rel=1e-12)


def test_the_necks_noise_does_not_matter_in_its_own_frame(head: HeadModel) -> None:
    noise = Noise(joint_rad=[0.1, 0.1, 0.1, 0.0, 0.0, 0.0, 0.0])
    assert not triangulate_gaze(head, head.fixate(POINT), noise).covariance.any()


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
