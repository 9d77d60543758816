"""The benchmark of calibrations: errors of the size of their sigmas, and a table of photographs."""

import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmarks import calibration, calibration_photographs

SHARED = Path(__file__).resolve().parents[2] / ".." / "shared" / "data" / "stereo_chessboard"


@pytest.mark.nightly
def test_drawn_corners_have_the_errors_that_the_detector_says():
    rng = np.random.default_rng(3)
    target = calibration.parse_target(calibration.TARGET)
    truth = calibration.drawn_truth("fisheye", target, rng)
    seen = calibration.photographed(target, truth, rng)
    error, sigma = calibration.corner_errors(seen, truth.pixels(target))
    assert 0.7 < np.sqrt(np.mean((error / sigma) ** 2)) < 1.4


@pytest.mark.nightly
@pytest.mark.skipif(not SHARED.is_dir(), reason=f"the photographs are not here: {SHARED}")
def test_photographs_give_a_row_with_errors_of_every_way(tmp_path, monkeypatch):
    monkeypatch.setattr(calibration_photographs, "SPLITS", 1)
    for number in range(1, 13):
        shutil.copy(SHARED / f"left{number}.jpg", tmp_path)
    csv = tmp_path / "table.csv"
    words = ["--set", str(tmp_path), "checkerboard:9x6:24.23", "brown-conrady", "--csv", str(csv)]
    calibration_photographs.main(words)
    (row,) = pd.read_csv(csv).to_dict("records")
    assert row["views"] == 12
    assert all(0.0 < row[way] < 0.4 for way in ("opencv", "opencv_ours", "ours"))
    assert row["ratio"] < 1.1
