"""The benchmark of calibrations: errors of the size of their sigmas, and a table of photographs."""

import cv2
import numpy as np
import pandas as pd
import pytest

from benchmarks import calibration, calibration_photographs
from vergence.models.parts import Rendering
from vergence.vision import TargetRenderer


@pytest.mark.nightly
def test_drawn_corners_have_the_errors_that_the_detector_says():
    rng = np.random.default_rng(3)
    target = calibration.parse_target(calibration.TARGET)
    truth = calibration.drawn_truth("fisheye", target, rng)
    seen = calibration.photographed(target, truth, rng)
    error, sigma = calibration.corner_errors(seen, truth.pixels(target))
    assert 0.7 < np.sqrt(np.mean((error / sigma) ** 2)) < 1.4


@pytest.mark.nightly
def test_photographs_give_a_row_with_errors_of_every_way(tmp_path, monkeypatch):
    monkeypatch.setattr(calibration_photographs, "SPLITS", 1)
    rng = np.random.default_rng(5)
    target = calibration.parse_target(calibration.TARGET)
    truth = calibration.drawn_truth("brown-conrady", target, rng)
    rendering = Rendering(
        blur_px=0.7, noise_grey=2.0, supersampling=2, black_grey=30.0, white_grey=210.0,
        background_grey=130.0,
    )  # fmt: skip
    drawing = TargetRenderer(calibration.eye_camera(truth.rig, 0), target, rendering)
    whole = np.isfinite(truth.pixels(target)[0]).all(axis=(1, 2))
    for view in np.flatnonzero(whole):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = truth.poses.rotation[view], truth.poses.translation[view]
        drawing.draw(pose, rng)
        cv2.imwrite(str(tmp_path / f"{view}.png"), drawing.frame)
    csv = tmp_path / "table.csv"
    calibration_photographs.main(
        ["--set", str(tmp_path), calibration.TARGET, "brown-conrady", "--csv", str(csv)]
    )
    (row,) = pd.read_csv(csv).to_dict("records")
    assert row["views"] == whole.sum()
    assert all(0.0 < row[way] < 0.2 for way in ("opencv", "opencv_ours", "ours"))
    assert row["ratio"] < 1.1
