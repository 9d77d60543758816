"""Heads and poses that the tests of the models share."""

import numpy as np
import pytest

from vergence.models import HeadModel, ModelErrors, load_head


@pytest.fixture
def head(physical, errors) -> HeadModel:
    """A head drawn about the preset with distortion: none of its numbers is a round one."""
    return physical.perturbed(np.random.default_rng(7), errors)


@pytest.fixture
def simulated() -> HeadModel:
    return load_head("simulated")


@pytest.fixture
def physical() -> HeadModel:
    return load_head("physical")


@pytest.fixture
def errors() -> ModelErrors:
    """Errors a few times those of a carelessly built head."""
    return ModelErrors(
        link_m=1e-3, coaxiality_rad=0.01, joint_offset_rad=0.02, head_eye_rad=0.01,
        head_eye_m=1e-3, focal_relative=0.01, principal_px=5.0, distortion=0.01,
    )  # fmt: skip


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20)


@pytest.fixture
def random_poses(rng):
    def draw(head: HeadModel, count: int) -> np.ndarray:
        return rng.uniform(head.limits.lower, head.limits.upper, (count, 7))

    return draw
