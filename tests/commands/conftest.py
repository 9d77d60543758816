"""Fixtures of the tests of commands."""

import pytest


@pytest.fixture
def undrawn(monkeypatch):
    """Run folders without a picture, which takes longer than the rest."""
    monkeypatch.setattr("vergence.eval.gaze_figure.draw_gaze", lambda *_: None)
    monkeypatch.setattr("vergence.eval.reporting.locate_figure.draw_located", lambda *_: None)
