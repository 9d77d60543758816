"""Fixtures shared by the tests of training."""

import pytest

from vergence.training import run


@pytest.fixture(scope="session", autouse=True)
def undrawn():
    """No run draws its curve, which takes as long as all else of a small one; see `runs.drawn`."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "draw_curve", lambda *_arguments: None)
        yield
