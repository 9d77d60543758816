"""Fixtures of the tests of commands: runs without their pictures, which take most of the time."""

import pytest


@pytest.fixture
def undrawn(monkeypatch):
    """Figures are not drawn, and reports have empty ones."""
    for place in ("gaze_figure.draw_gaze", "reporting.locate_figure.draw_located"):
        monkeypatch.setattr(f"vergence.eval.{place}", lambda *_: None)
    monkeypatch.setattr("vergence.eval.comparison.folder.evaluation_figures", lambda _: {})
    monkeypatch.setattr("vergence.eval.margins.folder.margin_figures", lambda _: {})
    for place in ("calibration", "calibration.head"):
        monkeypatch.setattr(f"vergence.{place}.report.svg_text", lambda _: "<svg></svg>")


@pytest.fixture(autouse=True)
def brief_search(monkeypatch):
    """Tags without OpenCV's search of hard cases, see tests/vision; light by fewer edges."""
    monkeypatch.setattr("vergence.vision.tags.detector.TagDetector._search_opencv", lambda *_: [])
    monkeypatch.setattr("vergence.perception.light._MAX_EDGES_PER_TARGET", 4)
