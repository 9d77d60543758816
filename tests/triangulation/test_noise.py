"""Covariances of fixes against derivatives of the fixes themselves, and the noise of a head.

Joints that one actuator moves have one error, not two.
"""

import numpy as np
import pytest

from tests.heads import head_of
from tests.models.lenses import LENSES, wide
from tests.naming import refused
from vergence import HeadModel, Noise, load_head, triangulate_gaze, triangulate_views
from vergence.triangulation import gap_sigma

POINT = np.array([0.1, -0.1, 0.7])
PIXEL_PX, JOINT_RAD = 0.05, 1e-4
HEADS = {
    **{name: load_head(name) for name in ("simulated", "physical")},
    **{left: wide(left, right) for left, right in zip(LENSES, reversed(LENSES), strict=True)},
    **{name: head_of(name) for name in ("tied", "mis", "panfirst")},
}


def point_at(depth: float, aside_deg: float) -> np.ndarray:
    return np.array([depth * np.tan(np.deg2rad(aside_deg)), -0.1, depth])


def propagated(point_of, shape: tuple[int, ...], step: float, sigma: float) -> np.ndarray:
    """Covariance of a point by central differences in inputs with one standard deviation."""
    nudges = step * np.eye(np.prod(shape)).reshape(-1, *shape)
    slopes = (point_of(nudges) - point_of(-nudges)) / (2.0 * step)
    return sigma**2 * np.einsum("ni,nj->ij", slopes, slopes)


def assert_equal(covariance: np.ndarray, expected: np.ndarray) -> None:
    assert expected.max() > 0.0
    np.testing.assert_allclose(covariance, expected, rtol=1e-5, atol=1e-6 * expected.max())


@pytest.mark.parametrize("name", HEADS)
def test_covariances_are_those_of_a_fixs_derivatives_by_pixels_and_actuators(name):
    head = HEADS[name]
    # the eyes look beside the target, so that the interaction of both axes counts
    q = head.fixate(POINT + [0.05, 0.05, 0.0])
    pixels, actuators = head.project(q, POINT), head.actuation.actuators_of(q)
    by_pixels = propagated(
        lambda by: triangulate_views(head, q, pixels + by, Noise()).point, (2, 2), 1e-3, PIXEL_PX
    )
    noise = Noise(pixel_px=PIXEL_PX)
    assert_equal(triangulate_views(head, q, pixels, noise).covariance, by_pixels)

    def turned(by: np.ndarray) -> np.ndarray:
        return head.actuation.joints_of(actuators + by)

    by_joints = propagated(
        lambda by: triangulate_views(head, turned(by), pixels, Noise()).point, (7,), 1e-6, JOINT_RAD
    )
    both = triangulate_views(head, q, pixels, Noise(pixel_px=PIXEL_PX, joint_rad=JOINT_RAD))
    assert_equal(both.covariance, by_pixels + by_joints)
    assert both.sigma == pytest.approx(np.sqrt(np.diag(both.covariance)), rel=1e-15)
    by_joints = propagated(
        lambda by: triangulate_gaze(head, turned(by), Noise()).point, (7,), 1e-6, JOINT_RAD
    )
    assert_equal(triangulate_gaze(head, q, Noise(joint_rad=JOINT_RAD)).covariance, by_joints)


def settled_angles(head: HeadModel, point: np.ndarray, noise_px: np.ndarray) -> np.ndarray:
    """Angles at which noisy detections of a point sit on the principal points.

    That is what a loop does with detections that are off by a constant: Newton's method.
    """
    q = np.broadcast_to(head.fixate(point), (len(noise_px), 7)).copy()
    for _ in range(8):
        error = head.undistort(head.project(q, point) + noise_px) - head.cameras.principal
        seen = head.project(q, point, distorted=False)
        inverse = np.linalg.inv(head.camera_poses(q))
        depth = inverse[..., 2, :3] @ point + inverse[..., 2, 3]
        J = head.image_jacobian(q, seen, depth)
        for eye in range(2):
            part = slice(3 + 2 * eye, 5 + 2 * eye)
            q[..., part] -= np.linalg.solve(J[..., eye, :, part], error[..., eye, :, None])[..., 0]
    return q


@pytest.mark.parametrize("point", [point_at(0.5, 25.0), point_at(2.5, 0.0)], ids=str)
def test_pixel_noise_of_gaze_reaches_the_point_through_the_settled_loop(head, point):
    expected = propagated(
        lambda by: triangulate_gaze(head, settled_angles(head, point, by), Noise()).point,
        (2, 2), 1e-3, PIXEL_PX,
    )  # fmt: skip
    fix = triangulate_gaze(head, head.fixate(point), Noise(pixel_px=PIXEL_PX))
    assert_equal(fix.covariance, expected)


def test_noise_of_a_head_is_that_of_its_detector_its_encoders_and_their_play(head):
    noise = Noise.of(head)
    assert np.all(noise.pixel_px == head.sensor.detection_noise_px)
    # what an even spread over one step has
    assert np.all(noise.joint_rad == head.sensor.encoder_resolution_rad / np.sqrt(12.0))
    q = head.fixate(POINT)
    of_head = triangulate_gaze(head, q, noise).covariance
    assert np.array_equal(triangulate_gaze(head, q).covariance, of_head)
    steps, plays = np.array([1e-3, 2e-3, 3e-3]), np.array([0.0, 0.01, 0.02])
    tied = HEADS["mis"].replace(actuators={"encoder_resolution_rad": steps})
    expected = np.array([tied.sensor.encoder_resolution_rad] * 3 + [*steps, 0.0]) / np.sqrt(12.0)
    assert Noise.of(tied).joint_rad == pytest.approx(expected)
    # play leaves what is driven on either side of its encoder
    loose = tied.replace(actuators={"backlash_rad": plays})
    expected = np.sqrt(steps**2 / 12.0 + (0.5 * plays) ** 2)
    assert Noise.of(loose).joint_rad[3:6] == pytest.approx(expected)


def test_noise_that_cannot_be_is_refused_by_name() -> None:
    for key, value, expected in (
        ("pixel_px", -0.1, ">= 0"),
        ("pixel_px", np.nan, "finite"),
        ("joint_rad", np.inf, "finite"),
        ("pixel_px", np.ones((2, 3)), r"\(\.\.\., 2, 2\)"),
        ("joint_rad", np.ones(4), r"\(\.\.\., 7\)"),
        ("joint_rad", "large", "large"),
    ):
        refused(rf"Noise\.{key}: expected .*{expected}", Noise, **{key: value})


@pytest.mark.parametrize("name", ["simulated", "icub"])
def test_gaps_of_noisy_views_have_the_predicted_spread(name, rng):
    head, samples = load_head(name), 4000
    points = np.array([[0.0, -0.1, 1.0], [0.2, 0.05, 0.6]])
    q = np.broadcast_to(head.rest(), (2, 7))
    pixels = head.project(q, points)
    actuators = head.actuation.actuators_of(q)
    errors = rng.normal(0.0, 3e-4, (samples, 1, 7)) * (head.actuation.velocity > 0.0)
    read = head.actuation.joints_of(actuators + errors)
    found = pixels + rng.normal(0.0, 0.4, (samples, *pixels.shape))
    gaps = triangulate_views(head, read, found).gap
    predicted = gap_sigma(head, q, pixels, Noise(pixel_px=0.4, joint_rad=3e-4))
    # a standard deviation of 4,000 samples is known to 1.1 %
    assert np.sqrt((gaps**2).mean(axis=0)) == pytest.approx(predicted, rel=0.05)
    assert not gap_sigma(head, q, pixels, Noise()).any()
    pixels[1, 0] = np.nan
    assert np.isfinite(gap_sigma(head, q, pixels)).tolist() == [True, False]
