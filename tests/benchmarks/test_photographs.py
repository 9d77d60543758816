"""Real photographs: a board is measured as large as it is, in views held out of the calibration."""

from pathlib import Path

import pytest

from benchmarks.photographs import detected, measure
from tests.naming import named

SHARED = Path(__file__).resolve().parents[2] / ".." / "shared" / "data" / "stereo_chessboard"
TARGET = "checkerboard:9x6:24.23"


@pytest.mark.nightly
@pytest.mark.skipif(not SHARED.is_dir(), reason=f"the photographs are not here: {SHARED}")
def test_neighbouring_corners_are_as_far_apart_as_they_are_printed():
    assert detected(SHARED, TARGET) == (58, 58)
    for finder in ("classic", "sb", "vergence"):
        with named(finder):
            got = measure(SHARED, TARGET, finder)
            assert got.pairs == got.views == 15
            assert got.mean_mm == pytest.approx(24.23, rel=0.002)
            assert got.spread_mm <= 0.25
