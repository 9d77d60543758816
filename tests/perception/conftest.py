"""Detectors that leave out their last resorts, which take most of the time."""

import pytest


@pytest.fixture(autouse=True)
def brief_search(request, monkeypatch):
    """Tags without OpenCV's search of hard cases, see tests/vision; light by fewer edges."""
    monkeypatch.setattr("vergence.vision.tags.detector.TagDetector._search_opencv", lambda *_: [])
    if "test_notes" not in request.node.nodeid:
        monkeypatch.setattr("vergence.perception.notes._MAX_EDGES_PER_TARGET", 4)
