"""Fixtures of the evaluation's tests."""

import pytest


@pytest.fixture
def toy(monkeypatch):
    """The registry of experiments holds the toy experiment alone."""
    for module in ("experiment", "folder", "overrides", "reproduce"):
        monkeypatch.setattr(
            f"vergence.eval.article.{module}.EXPERIMENTS",
            {"toy": "tests.eval.article.toy:EXPERIMENT"},
        )
