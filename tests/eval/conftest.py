"""Fixtures of the evaluation's tests."""

import sys
from pathlib import Path

import pytest

from vergence.eval import experiment

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture
def toy(monkeypatch):
    """The registry of experiments holds the toy experiment alone."""
    monkeypatch.setattr(experiment, "EXPERIMENTS", {"toy": "toy:EXPERIMENT"})
    for module in ("vergence.eval.reproduce",):
        __import__(module)
        monkeypatch.setattr(sys.modules[module], "EXPERIMENTS", {"toy": "toy:EXPERIMENT"})
