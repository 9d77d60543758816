"""A calibrated head's depth errors, run folder and report."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

import vergence
from tests.calibration.test_report import Page
from vergence.calibration.head import report
from vergence.calibration.head.calibrate import (
    calibrate_head,
    points_at_angles,
    predict_depth_errors,
)
from vergence.calibration.head.judge import UnobservableDirection
from vergence.calibration.head.report import left_out_views, result_document, write_run
from vergence.calibration.head.simulated import simulate_recording
from vergence.eval.trials.twin_errors import TWIN_SPREADS
from vergence.models.posture import midpoint_between_cameras
from vergence.reporting.runs import run_folder_command
from vergence.reporting.text import format_number
from vergence.triangulation import triangulate_gaze, triangulate_views

HEAD = vergence.load_head("physical")
DISTANCES_M = np.array([0.5, 1.0, 2.5])
UNSEEN = (
    UnobservableDirection("tilt of both eyes", "move the neck", "17 mm at 1 m"),
    UnobservableDirection("an offset against a turn", "", "nothing depends on it"),
)
FACTS = {"frames": "frames.npz", "sha256": "0123"}
WRONG = (0, 5)
"""Eye and frame of a view whose corners are not where they were seen."""


@pytest.fixture(scope="module")
def true():
    return HEAD.perturbed(np.random.default_rng(4), TWIN_SPREADS)


@pytest.fixture(scope="module")
def found(true):
    rng = np.random.default_rng(5)
    seen = simulate_recording(HEAD, true, rng, poses=12, frames_per_pose=2).frames
    pixels = seen.pixels.copy()
    pixels[WRONG] += rng.normal(0.0, 30.0, pixels[WRONG].shape)
    return calibrate_head(HEAD, replace(seen, pixels=pixels))


@pytest.fixture
def undrawn(monkeypatch):
    monkeypatch.setattr(report, "_figures", lambda found: {})


def written(folder, found, unseen=UNSEEN):
    write_run(folder, found, result_document(found, unseen), "name = 'mine'\n", "mine.toml", FACTS)
    return Page((folder / "calibration.html").read_text(encoding="utf-8"))


@pytest.mark.slow
def test_the_error_before_is_the_one_that_the_true_head_tells(found, true):
    aside = points_at_angles(1.0, np.array([-0.4]), np.array([0.3]))
    from_eyes = np.concatenate([points_at_angles(DISTANCES_M), aside])
    depth = predict_depth_errors(found, from_eyes)
    points = midpoint_between_cameras(true) + from_eyes
    q = true.fixate(points)
    off = triangulate_views(HEAD, q, true.cameras.principal).point - points
    along = (off * from_eyes).sum(axis=-1) / np.linalg.norm(from_eyes, axis=-1)
    assert (np.abs(along) > 4.0 * depth.sigma_m).all()
    assert (np.abs(depth.nominal_error_m - along) < 3.0 * depth.sigma_m).all()
    np.testing.assert_allclose(depth.nominal_error_norm_m, np.linalg.norm(off, axis=-1), rtol=0.2)


def test_the_floor_is_that_of_a_settled_fixation_and_nothing_beyond_the_limits_has_one(found):
    q = found.head.fixate(midpoint_between_cameras(found.head) + points_at_angles(DISTANCES_M))
    floor = triangulate_gaze(found.head, q).sigma[:, 2]
    depth = predict_depth_errors(found, points_at_angles(DISTANCES_M))
    np.testing.assert_allclose(depth.noise_floor_m, floor, rtol=1e-6)
    depth = predict_depth_errors(found, points_at_angles(1.0, np.array([0.0, 1.4]), np.zeros(2)))
    for values in (depth.sigma_m, depth.nominal_error_m, depth.noise_floor_m):
        assert np.isfinite(values).tolist() == [True, False]


def test_the_run_folder_has_the_head_all_numbers_and_every_view(found, tmp_path, undrawn):
    written(tmp_path, found)
    assert {path.name for path in tmp_path.iterdir()} == {
        "mine.toml", "result.json", "views.csv", "calibration.html",
    }  # fmt: skip
    assert run_folder_command(tmp_path) == "calibrate"
    assert (tmp_path / "mine.toml").read_text() == "name = 'mine'\n"
    result = json.loads((tmp_path / "result.json").read_text(), parse_constant=pytest.fail)
    counts = [result[name] for name in ("views", "left_out", "frames", "poses")]
    assert counts == [47, 1, 24, 12]
    row = next(row for row in result["depth"] if row["distance_m"] == 1.0)
    depth = predict_depth_errors(found, points_at_angles(np.ones(1)))
    assert row["before_mm"] == pytest.approx(1e3 * depth.nominal_error_m[0])
    assert row["after_percent"] == pytest.approx(0.1 * row["after_sigma_mm"])
    assert result["unseen"][0] == UNSEEN[0]._asdict()
    # the corners' noise was 0.05 px in either coordinate
    assert result["rms_px"] == pytest.approx(0.05 * np.sqrt(2.0), rel=0.1)
    names, units, _ = HEAD.parameters()
    assert (tuple(result["names"]), tuple(result["units"])) == (names, units)
    head = HEAD.with_parameters(result["after"])
    q = HEAD.rest()
    np.testing.assert_array_equal(head.camera_poses(q), found.head.camera_poses(q))
    np.testing.assert_allclose(np.diagonal(result["covariance"]), np.square(result["sigma"]))
    assert result["recording"] == FACTS
    assert set(result["noisier"]) == set(HEAD.joints)
    with (tmp_path / "views.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    kept = [row for row in rows if row["kept"] == "True"]
    assert (len(rows), len(kept)) == (48, 47)
    squares = np.array([[float(row["corners"]), float(row["rms_px"]) ** 2] for row in kept])
    mean = np.average(squares[:, 1], weights=squares[:, 0])
    assert np.sqrt(mean) == pytest.approx(result["rms_px"])


def test_the_view_that_was_wrong_is_named(found, tmp_path, undrawn):
    (one,) = left_out_views(found)
    assert (one["eye"], one["time_s"]) == ("left", found.frames.time_s[WRONG[1]])
    assert "times sigma, where others leave" in one["why"]
    assert one["why"] in written(tmp_path, found).text


def test_the_page_says_before_and_after_and_what_was_not_seen(found, tmp_path, undrawn):
    text = written(tmp_path, found).text
    depth = predict_depth_errors(found, points_at_angles(DISTANCES_M))
    values_mm = (np.abs(1e3 * one) for one in (depth.nominal_error_m, depth.sigma_m))
    before, after = ("{}, {} and {}".format(*map(format_number, one)) for one in values_mm)
    assert f"{before} mm off in depth at 0.5, 1 and 2.5 m" in text
    assert f"one standard deviation is {after} mm" in text
    assert "tilt of both eyes: 17 mm at 1 m. To determine it: move the neck." in text
    assert text.count("To determine it") == 1  # nothing is said of what needs nothing
    assert all(fact in text for fact in FACTS.values())


@pytest.mark.nightly
def test_the_report_is_one_file_with_all_figures(found, tmp_path):
    page = written(tmp_path, found)
    eyes = {f"{kind}-{eye}" for kind in ("residuals", "coverage") for eye in ("left", "right")}
    assert set(page.figures) == eyes | {
        "depth", "map-1", "map-2.5", "views", "joints", "readings", "correlations",
    }  # fmt: skip
    assert [link for link in page.links if not link.startswith(("#", "data:"))] == []
