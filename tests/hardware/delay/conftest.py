"""Shorter motions than those of a real measurement: their fits take a third of the time."""

import pytest

from vergence.hardware.delay import measure


@pytest.fixture(autouse=True)
def brief(monkeypatch, request):
    """Motions as short as still tells a loop, but in nightly tests."""
    if not request.node.get_closest_marker("nightly"):
        for part, length_s in (("SLOW", 1.6), ("CHIRP", 3.0), ("REVERSALS", 1.0)):
            monkeypatch.setattr(measure, f"_{part}_DURATION_S", length_s)
        monkeypatch.setattr(measure, "_CENTRING_S", 1.0)
