"""`vergence calibrate`: a head file or a camera out of photographs, or a line on why not."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.calibration.rigs import BOARD, SIZE, make_poses, make_rig
from tests.commands.called import call, refused
from tests.naming import named
from vergence.models import load_head
from vergence.models.files.intrinsics import read_intrinsics
from vergence.models.parts import Rendering
from vergence.vision import EyeCamera, TargetRenderer

SHARED = Path(__file__).resolve().parents[2] / ".." / "shared" / "data" / "stereo_chessboard"
TARGET = "checkerboard:9x6:24"
VIEWS = 8
RENDERING = Rendering(
    blur_px=0.7, noise_grey=2.0, supersampling=2, black_grey=30.0, white_grey=210.0,
    background_grey=130.0,
)  # fmt: skip


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    """Pairs of photographs of a board, drawn through a lens; right03.png is none."""
    folder = tmp_path_factory.mktemp("photographs")
    rng = np.random.default_rng(11)
    rig, poses = make_rig(), make_poses(rng, 5 * VIEWS)
    drawings = [
        TargetRenderer(
            EyeCamera(
                width=SIZE[0], height=SIZE[1], focal_px=tuple(values[:2]),
                principal_px=tuple(values[2:4]), distortion=tuple(values[4:]),
            ),
            BOARD,
            RENDERING,
        )
        for values in rig.camera_parameters
    ]  # fmt: skip
    taken = 0
    for turn, shift in zip(*poses, strict=True):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn, shift
        between = np.eye(4)
        between[:3, :3], between[:3, 3] = rig.rotation, rig.translation
        whole = True
        for drawing, where in zip(drawings, (pose, between @ pose), strict=True):
            drawing.draw(where, rng)
            x0, y0, x1, y1 = drawing.region or (0, 0, *SIZE)
            whole &= x0 > 0 and y0 > 0 and x1 < SIZE[0] and y1 < SIZE[1]
        if whole and taken < VIEWS:
            taken += 1
            for eye, drawing in zip(("left", "right"), drawings, strict=True):
                cv2.imwrite(str(folder / f"{eye}{taken:02d}.png"), drawing.frame)
    assert taken == VIEWS
    (folder / "right03.png").write_bytes(b"no image")
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
    assert "right03.png" in err
    said = json.loads(out)
    assert set(said) == {
        "rms_left_px", "rms_right_px", "rms_stereo_px", "rms_heldout_px", "baseline_mm",
        "baseline_sigma_mm", "lens", "views", "dropped", "advice",
    }  # fmt: skip
    assert said["dropped"] == [
        {"view": "right03.png", "why": "it could not be read; the left image went in"}
    ]
    expected = 1e3 * np.linalg.norm(make_rig().translation)
    assert abs(said["baseline_mm"] - expected) < 4.0 * said["baseline_sigma_mm"]
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
    camera = read_intrinsics(["left.yaml"]).left
    assert (camera.width, camera.height) == SIZE
    np.testing.assert_allclose(camera.focal, make_rig().camera_parameters[0][:2], rtol=0.01)


@pytest.mark.slow
def test_what_is_wrong_with_photographs_is_said(photographs, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    one, grey, small = (tmp_path / name for name in ("one", "grey", "small"))
    for folder in (one, grey, small):
        folder.mkdir()
    for eye in ("left", "right"):
        (one / f"{eye}1.png").write_bytes((photographs / f"{eye}01.png").read_bytes())
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
