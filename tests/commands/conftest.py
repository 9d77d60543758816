"""Fixtures of the tests of commands."""

import pytest


@pytest.fixture(autouse=True)
def brief_search(monkeypatch):
    """Tags without OpenCV's search of hard cases, see tests/vision; light by fewer edges."""
    monkeypatch.setattr("vergence.vision.tags.detector.TagDetector._search_opencv", lambda *_: [])
    monkeypatch.setattr("vergence.perception.notes._MAX_EDGES_PER_TARGET", 4)
