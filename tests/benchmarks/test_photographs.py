"""Real photographs: a board is measured as large as it is, in views held out of the calibration."""

from pathlib import Path

import pytest

from benchmarks.photographs import detected, measure

SHARED = Path(__file__).resolve().parents[2] / ".." / "shared" / "data" / "stereo_chessboard"
TARGET = "checkerboard:9x6:24.23"


@pytest.fixture(autouse=True)
def photographs() -> Path:
    if not SHARED.is_dir():
        pytest.skip(f"the photographs are not here: {SHARED}")
    return SHARED


@pytest.mark.slow
def test_the_board_is_found_in_every_image():
    assert detected(SHARED, TARGET) == (58, 58)


@pytest.mark.slow
@pytest.mark.parametrize("finder", ["classic", "sb", "vergence"])
def test_neighbouring_corners_are_as_far_apart_as_they_are_printed(finder):
    got = measure(SHARED, TARGET, finder)
    assert got.pairs == got.views == 15
    assert got.mean_mm == pytest.approx(24.23, rel=0.002)
    assert got.spread_mm <= 0.25
