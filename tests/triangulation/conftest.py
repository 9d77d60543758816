"""Heads and random numbers that the tests of triangulation share."""

import numpy as np
import pytest

from vergence.models import HeadModel, load_head


@pytest.fixture(params=["simulated", "physical"])
def head(request: pytest.FixtureRequest) -> HeadModel:
    """Both presets."""
    return load_head(request.param)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20)
