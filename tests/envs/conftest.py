"""Heads that the tests of the environments share."""

import pytest

from vergence.models import HeadModel, load_head


@pytest.fixture
def simulated() -> HeadModel:
    return load_head("simulated")


@pytest.fixture
def physical() -> HeadModel:
    return load_head("physical")


@pytest.fixture(params=["simulated", "physical"])
def head(request: pytest.FixtureRequest) -> HeadModel:
    return load_head(request.param)


@pytest.fixture(params=["kinematic", "mujoco"])
def plant_name(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def exact(simulated: HeadModel) -> HeadModel:
    """The simulated head with a detector that makes no errors."""
    return simulated.replace(sensor={"detection_noise_px": 0.0})
