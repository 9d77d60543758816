"""Fixtures of the comparisons' tests."""

import pytest


@pytest.fixture
def undrawn(monkeypatch):
    """Run folders of evaluations without figures, which take longer than the rest."""
    monkeypatch.setattr("vergence.eval.comparison.folder.evaluation_figures", lambda _: {})
