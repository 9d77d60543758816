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
