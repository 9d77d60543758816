"""`vergence import stereo`: a calibration becomes a head that finds points in space."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.commands.called import call, refused
from tests.models.files.pairs import (
    D_LEFT,
    D_RIGHT,
    K_LEFT,
    K_RIGHT,
    R,
    T,
    camera_info,
    opencv_pair,
    write_opencv,
)
from vergence import triangulate_views
from vergence.models import HeadModel, load_head


def imported(folder: Path, *files: object) -> HeadModel:
    """The head that the command makes of a calibration, without a drawing."""
    assert call("import", "stereo", *files, "--out", folder / "head.toml", "--no-figure") == 0
    return load_head(folder / "head.toml")


def seen(points: np.ndarray) -> np.ndarray:
    """(n, 2, 2) pixels of points (n, 3) in the left camera, as OpenCV projects them."""
    left = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K_LEFT, D_LEFT)[0][:, 0]
    right = cv2.projectPoints(points, cv2.Rodrigues(R)[0], T, K_RIGHT, D_RIGHT)[0][:, 0]
    return np.stack([left, right], axis=1)


def test_an_imported_pair_finds_points_where_opencv_puts_them(tmp_path):
    points = np.random.default_rng(3).uniform([-0.2, -0.15, 0.4], [0.2, 0.15, 2.0], (50, 3))
    (tmp_path / "ros").mkdir()
    pair = write_opencv(tmp_path / "pair.xml", opencv_pair())
    ros = [camera_info(tmp_path / f"{e}.yaml", i) for i, e in enumerate(("left", "right"))]
    # a camera_info file has eight decimals of a rotation and of a pixel
    for folder, files, within_m in ((tmp_path, [pair], 1e-9), (tmp_path / "ros", ros, 2e-6)):
        head = imported(folder, *files)
        fix = triangulate_views(head, head.rest(), seen(points))
        assert fix.valid.all()
        T_N_Cl = head.camera_poses(head.rest())[0]
        expected = points @ T_N_Cl[:3, :3].T + T_N_Cl[:3, 3]
        np.testing.assert_allclose(fix.point, expected, atol=within_m)


def test_what_was_read_is_printed_and_what_a_calibration_does_not_say_is_marked(tmp_path, capsys):
    four = {f"distCoeffs{i}": np.array([[0.1, 0.02, 1e-3, 2e-3]]) for i in (1, 2)}
    assumed = imported(tmp_path, write_opencv(tmp_path / "pair.yml", opencv_pair(**four)))
    assert "sensor.detection_noise_px" in assumed.assumptions
    assert "--lens fisheye" in assumed.assumptions["eyes.left.distortion"]
    printed = " ".join(capsys.readouterr().out.split())
    for word in ("baseline", "640 x 480", "not in a calibration"):
        assert word in printed


def test_what_is_unusual_of_a_pair_is_said(tmp_path, capsys):
    unusual = opencv_pair(image_width=1280, image_height=960, T=np.array([0.0, 0.1, 0.0]))
    imported(tmp_path, write_opencv(tmp_path / "pair.yml", unusual))
    said = capsys.readouterr().err
    assert "assumed: the cameras stand one above the other" in said
    assert "assumed: left camera: principal point (322, 246) far from the middle of 1280" in said


@pytest.mark.nightly
def test_the_head_is_drawn_beside_its_file_unless_told_not_to(tmp_path, capsys):
    path = write_opencv(tmp_path / "pair.yml", opencv_pair())
    out = tmp_path / "new" / "head.toml"
    assert call("import", "stereo", path, "--out", out) == 0
    drawing = cv2.imread(str(out.with_suffix(".png")))
    assert min(drawing.shape[:2]) > 500
    assert capsys.readouterr().out.splitlines()[-2:] == [str(out), str(out.with_suffix(".png"))]


@pytest.mark.slow
def test_what_cannot_be_imported_is_refused_in_one_line(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_opencv(tmp_path / "pair.yml", opencv_pair())
    (tmp_path / "desk.toml").write_text("[image]\nwidth_px = 640\n", encoding="utf-8")
    for words, said in [
        (["desk.toml"], "desk.toml: expected a calibration (YAML, XML or JSON), got a TOML file"),
        (["none.yml"], "none.yml: No such file"),
        (["pair.yml", "--size", "640", "480"], "a size is one word: --size 640x480"),
        (["pair.yml", "--swap"], "without --swap"),
        (["pair.yml", "--name", "a/b"], "a name that a file may have"),
        ([], "expected calibration files"),
    ]:
        assert said in refused(capsys, "import", "stereo", *words, "--out", "head.toml")
        assert not (tmp_path / "head.toml").exists()


def test_a_mistake_in_the_input_is_told_before_one_in_the_output(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_opencv(tmp_path / "pair.yml", opencv_pair())
    (tmp_path / "head.toml").write_text("mine", encoding="utf-8")
    for words, said in ((["none.yml"], "none.yml"), (["pair.yml"], "--force")):
        # to head.toml by default
        assert said in refused(capsys, "import", "stereo", *words, "--no-figure")
    assert (tmp_path / "head.toml").read_text(encoding="utf-8") == "mine"
    assert call("import", "stereo", "pair.yml", "--no-figure", "--force") == 0
    assert load_head(tmp_path / "head.toml").name == "head"


def test_fisheyes_of_two_sizes_are_imported_as_they_are(tmp_path):
    four = {f"distCoeffs{i}": np.array([[0.02, -0.01, 2e-3, -1e-3]]) for i in (1, 2)}
    values = opencv_pair(
        **four, image_width=None, image_height=None, imageSize1=np.array([640, 480]),
        imageSize2=np.array([800, 600]), fisheye_model=1,
    )  # fmt: skip
    path = write_opencv(tmp_path / "pair.yml", values)
    head = imported(tmp_path, path)
    assert head.cameras.size.tolist() == [[640, 480], [800, 600]]
    points = np.array([[0.4, -0.2, 0.5], [-0.3, 0.3, 0.6]])
    pixels = [
        cv2.fisheye.projectPoints(points[:, None], rotation, t, k, values["distCoeffs1"].T)[0]
        for rotation, t, k in (
            (np.zeros(3), np.zeros(3), K_LEFT), (cv2.Rodrigues(R)[0], T, K_RIGHT),
        )
    ]  # fmt: skip
    views = np.stack([one.reshape(-1, 2) for one in pixels], axis=1)
    T_N_Cl = head.camera_poses(head.rest())[0]
    fix = triangulate_views(head, head.rest(), views)
    np.testing.assert_allclose(fix.point, points @ T_N_Cl[:3, :3].T + T_N_Cl[:3, 3], atol=1e-9)
