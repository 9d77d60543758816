"""`vergence calibrate`: a head file or a camera out of photographs, or a line on why not."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.commands.called import call, refused
from tests.heads import head_of
from tests.naming import named
from tests.perception.drawn import Studio, pose_at
from vergence.models import load_head
from vergence.models.stereo_files import read_intrinsics
from vergence.vision.targets import Checkerboard

SHARED = Path(__file__).resolve().parents[2] / ".." / "shared" / "data" / "stereo_chessboard"
TARGET, BOARD = "checkerboard:9x6:24", Checkerboard(columns=9, rows=6, square_m=0.024)
VIEWS = 7


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    """Pairs of photographs of a board: left1.png, right1.png, ...; right3.png is none."""
    folder, rng = tmp_path_factory.mktemp("photographs"), np.random.default_rng(11)
    studio = Studio(head_of("pair"), BOARD)
    for number in range(1, VIEWS + 1):
        place = rng.uniform([-0.05, -0.03, 0.5], [0.05, 0.03, 0.65])
        pose = pose_at(place, rng.uniform(-0.5, 0.5, 3))
        pose[:3, 3] -= pose[:3, :2] @ BOARD.corners_m.mean(axis=0)
        images = studio.take(pose, rng)
        for eye, image in zip(("left", "right"), images, strict=True):
            cv2.imwrite(str(folder / f"{eye}{number}.png"), image)
    (folder / "right3.png").write_bytes(b"no image")
    return folder


def stereo(folder: Path, *words: object) -> tuple[object, ...]:
    return (
        "calibrate", "stereo", "--left", folder / "left*.png", "--right", folder / "right*.png",
        "--target", TARGET, "--lens", "brown-conrady", *words,
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_pair_becomes_a_head_that_other_commands_take(photographs, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert call(*stereo(photographs, "--out", "pair.toml", "--json")) == 2  # one is broken
    out, err = capsys.readouterr()
    assert "right3.png" in err
    said = json.loads(out)
    assert set(said) == {
        "rms_left_px", "rms_right_px", "rms_stereo_px", "rms_heldout_px", "baseline_mm",
        "baseline_sigma_mm", "lens", "views", "dropped", "advice",
    }  # fmt: skip
    assert said["dropped"] == [
        {"view": "right3.png", "why": "it could not be read; the left image went in"}
    ]
    assert abs(said["baseline_mm"] - 100.0) < 4.0 * said["baseline_sigma_mm"]
    assert said["baseline_sigma_mm"] < 1.0
    assert load_head("pair.toml").calibration.target == TARGET
    (run,) = (tmp_path / "runs").iterdir()
    assert {path.name for path in run.iterdir()} == {
        "calibration.html", "pair.toml", "result.json", "views.csv",
    }  # fmt: skip
    assert call("info", "--head", "pair.toml", "--json") == 0
    assert json.loads(capsys.readouterr().out)["calibration"]["views"] == said["views"]
    # a file of that name is replaced only if that is said, before any work is done
    before = Path("pair.toml").read_bytes()
    line = refused(capsys, *stereo(tmp_path / "nowhere", "--out", "pair.toml"))
    assert "--force replaces it" in line
    assert Path("pair.toml").read_bytes() == before


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_camera_becomes_a_file_that_detectors_take(photographs, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ("calibrate", "intrinsics", photographs / "left*.png", "--board", TARGET)
    assert call(*words, "--lens", "brown-conrady", "--out", "left.yaml") == 0
    assert "f_u" in capsys.readouterr().out
    read = read_intrinsics(["left.yaml"])
    assert not read.notes
    camera = read.left
    assert (camera.width, camera.height) == (320, 240)
    np.testing.assert_allclose(camera.focal, 343.0, rtol=0.02)


@pytest.mark.slow
def test_what_is_wrong_with_photographs_is_said(photographs, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    one, grey, small = (tmp_path / name for name in ("one", "grey", "small"))
    for folder in (one, grey, small):
        folder.mkdir()
    for eye in ("left", "right"):
        (one / f"{eye}1.png").write_bytes((photographs / f"{eye}1.png").read_bytes())
        for number, size in enumerate(((240, 320), (240, 320), (120, 160))):
            image = np.full(size, 90, np.uint8)
            cv2.imwrite(str(small / f"{eye}{number}.png"), image)
            if not number:
                cv2.imwrite(str(grey / f"{eye}{number}.png"), image)
    for folder, words, message in (
        (tmp_path / "nowhere", (), "expected images, got none that match"),
        (small, (), "got 320 x 240 px in most and 160 x 120 in left2.png"),
        (grey, (), "found in none of 1 image"),
        (one, ("--target", "checkerboard:8x6:24"), "checkerboard:9x6:24 (inner corners)"),
        (one, ("--target", "tag:36h11:5:120"), "expected a board with many corners"),
        (one, ("--response", "9"), "response: expected 'linear', 'srgb', a gamma"),
        (one, ("--out", "pair.yaml"), "expected a name that ends in .toml"),
    ):
        with named(message):
            assert call(*stereo(folder, *words)) == 2
            out, err = capsys.readouterr()
            assert out == ""
            assert message in err
    assert not list(tmp_path.glob("*.toml"))
    assert not (tmp_path / "runs").exists()


@pytest.mark.nightly
@pytest.mark.skipif(not SHARED.is_dir(), reason=f"the photographs are not here: {SHARED}")
def test_public_photographs_are_calibrated_to_what_others_found(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["calibrate", "stereo", "--target", "checkerboard:9x6:24.23", "--json"]
    for eye in ("left", "right"):
        words += [f"--{eye}", SHARED / f"{eye}*.jpg"]
    assert call(*words) == 0
    said = json.loads(capsys.readouterr().out)
    assert max(said["rms_left_px"], said["rms_right_px"]) <= 0.175
    assert said["rms_stereo_px"] <= 0.25
    assert said["rms_heldout_px"] <= 0.26  # 0.2499: the board moved between the two exposures
    assert said["baseline_mm"] == pytest.approx(93.9, abs=0.2)
    assert said["views"] == 29
