"""Heads that the tests of triangulation share."""

import numpy as np
import pytest

from vergence.models import HeadModel, ModelErrors, load_head


@pytest.fixture(params=["simulated", "physical"])
def head(request: pytest.FixtureRequest) -> HeadModel:
    """Both presets."""
    return load_head(request.param)


@pytest.fixture
def simulated() -> HeadModel:
    return load_head("simulated")


@pytest.fixture
def errors() -> ModelErrors:
    """Errors of a head built with care: up to 2.5 m its axes still cross ahead of it."""
    return ModelErrors(
        link_m=5e-4, coaxiality_rad=3e-3, joint_offset_rad=3e-3, head_eye_rad=3e-3,
        head_eye_m=5e-4, focal_relative=0.01, principal_px=1.0, distortion=0.01,
    )  # fmt: skip


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20)


def settled_angles(
    true: HeadModel, nominal: HeadModel, points: np.ndarray, noise: np.ndarray | float = 0.0
) -> np.ndarray:
    """Angles at which a true head's noisy detections of points sit on nominal principal points.

    That is what a loop does with detections that are off by a constant: Newton's method.
    """
    q = nominal.fixate(points)
    for _ in range(8):
        error = nominal.undistort(true.project(q, points) + noise) - nominal.cameras.principal
        seen = true.project(q, points, distorted=False)
        inverse = np.linalg.inv(true.camera_poses(q))
        depth = (inverse[..., 2, :3] * points[..., None, :]).sum(axis=-1) + inverse[..., 2, 3]
        J = true.image_jacobian(q, seen, depth)
        for eye in range(2):
            part = slice(3 + 2 * eye, 5 + 2 * eye)
            q[..., part] -= np.linalg.solve(J[..., eye, :, part], error[..., eye, :, None])[..., 0]
    return q
