"""Fixtures of the evaluation's tests."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture
def toy(monkeypatch):
    """The registry of experiments holds the toy experiment alone."""
    for module in ("experiment", "experiment_folder", "overrides", "reproduce"):
        monkeypatch.setattr(f"vergence.eval.{module}.EXPERIMENTS", {"toy": "toy:EXPERIMENT"})
