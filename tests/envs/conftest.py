"""Heads that the tests of the environments share."""

import pytest

from vergence.envs import views
from vergence.models import HeadModel, load_head


@pytest.fixture
def simulated() -> HeadModel:
    return load_head("simulated")


@pytest.fixture
def physical() -> HeadModel:
    return load_head("physical")


@pytest.fixture
def exact(simulated: HeadModel) -> HeadModel:
    """The simulated head with a detector that makes no errors."""
    return simulated.replace(sensor={"detection_noise_px": 0.0})


@pytest.fixture
def without_opengl(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine on which MuJoCo's renderer cannot draw."""
    monkeypatch.setattr(views, "opengl_works", lambda: False)
