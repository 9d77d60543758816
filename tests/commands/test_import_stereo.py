"""`vergence import stereo`: a calibration becomes a head that finds points in space."""

from pathlib import Path

import cv2
import numpy as np
import pytest

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
from vergence.cli import main
from vergence.models import load_head

SHARED = Path(__file__).resolve().parents[2] / ".." / "shared" / "data" / "stereo_chessboard"


def run(*words: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    assert isinstance(ended.value.code, int)
    return ended.value.code


def seen(points: np.ndarray) -> np.ndarray:
    """(n, 2, 2) pixels of points (n, 3) in the left camera, as OpenCV projects them."""
    left = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K_LEFT, D_LEFT)[0][:, 0]
    right = cv2.projectPoints(points, cv2.Rodrigues(R)[0], T, K_RIGHT, D_RIGHT)[0][:, 0]
    return np.stack([left, right], axis=1)


@pytest.mark.parametrize("kind", ["opencv", "ros"])
def test_an_imported_pair_finds_points_where_opencv_puts_them(tmp_path, kind):
    files = [write_opencv(tmp_path / "pair.xml", opencv_pair())]
    if kind == "ros":
        files = [camera_info(tmp_path / f"{e}.yaml", i) for i, e in enumerate(("left", "right"))]
    assert run("import", "stereo", *files, "--out", tmp_path / "head.toml", "--no-figure") == 0
    head = load_head(tmp_path / "head.toml")
    rng = np.random.default_rng(3)
    points = rng.uniform([-0.2, -0.15, 0.4], [0.2, 0.15, 2.0], (50, 3))
    fix = triangulate_views(head, head.rest(), seen(points))
    assert fix.valid.all()
    T_N_Cl = head.camera_poses(head.rest())[0]
    expected = points @ T_N_Cl[:3, :3].T + T_N_Cl[:3, 3]
    # a camera_info file has eight decimals of a rotation and of a pixel
    np.testing.assert_allclose(fix.point, expected, atol=1e-9 if kind == "opencv" else 2e-6)


def test_n_is_midway_between_the_cameras_of_a_pair_and_looks_where_they_look(tmp_path):
    path = write_opencv(tmp_path / "pair.yml", opencv_pair())
    assert run("import", "stereo", path, "--out", tmp_path / "head.toml", "--no-figure") == 0
    head = load_head(tmp_path / "head.toml")
    poses = head.camera_poses(head.rest())
    np.testing.assert_allclose(poses[:, :3, 3].mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(poses[:, :2, 2].sum(axis=0), 0.0, atol=1e-12)
    assert poses[1, 0, 3] > 0.0 > poses[0, 0, 3]
    assert head.actuation.count == 0


def test_what_a_calibration_does_not_say_is_marked(tmp_path):
    four = {f"distCoeffs{i}": np.array([[0.1, 0.02, 1e-3, 2e-3]]) for i in (1, 2)}
    path = write_opencv(tmp_path / "pair.yml", opencv_pair(**four))
    assert run("import", "stereo", path, "--out", tmp_path / "head.toml", "--no-figure") == 0
    assumed = load_head(tmp_path / "head.toml").assumptions
    assert "sensor.detection_noise_px" in assumed
    assert "--lens fisheye" in assumed["eyes.left.distortion"]


def test_what_was_read_is_printed(tmp_path, capsys):
    path = write_opencv(tmp_path / "pair.yml", opencv_pair())
    assert run("import", "stereo", path, "--out", tmp_path / "head.toml", "--no-figure") == 0
    printed = capsys.readouterr().out
    assert "baseline" in printed
    assert "640 x 480" in printed
    assert "not in a calibration" in printed


def test_what_is_unusual_of_a_pair_is_said(tmp_path, capsys):
    unusual = opencv_pair(image_width=1280, image_height=960, T=np.array([0.0, 0.1, 0.0]))
    path = write_opencv(tmp_path / "pair.yml", unusual)
    assert run("import", "stereo", path, "--out", tmp_path / "head.toml", "--no-figure") == 0
    said = capsys.readouterr().err
    assert "assumed: the cameras stand one above the other" in said
    assert "assumed: left camera: principal point (322, 246) far from the middle of 1280" in said


@pytest.mark.slow
def test_the_head_is_drawn_beside_its_file_unless_told_not_to(tmp_path, capsys):
    path = write_opencv(tmp_path / "pair.yml", opencv_pair())
    out = tmp_path / "new" / "head.toml"
    assert run("import", "stereo", path, "--out", out) == 0
    drawing = cv2.imread(str(out.with_suffix(".png")))
    assert min(drawing.shape[:2]) > 500
    assert capsys.readouterr().out.splitlines()[-2:] == [str(out), str(out.with_suffix(".png"))]
    assert run("import", "stereo", path, "--out", out) == 2
    assert "--force" in capsys.readouterr().err
    assert run("import", "stereo", path, "--out", out, "--force", "--no-figure") == 0


def test_what_cannot_be_imported_is_refused_in_one_line(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_opencv(tmp_path / "pair.yml", opencv_pair())
    (tmp_path / "desk.toml").write_text("[image]\nwidth_px = 640\n", encoding="utf-8")
    for words, said in [
        (["desk.toml"], "desk.toml: expected a calibration (YAML, XML or JSON), got a TOML file"),
        (["pair.yml", "--size", "640"], "expected WIDTHxHEIGHT"),
        (["none.yml"], "none.yml: No such file"),
        (["pair.yml", "--size", "640", "480"], "a size is one word: --size 640x480"),
        (["pair.yml", "--size", "320x240"], "320 x 240"),
        (["pair.yml", "--unit", "mm"], "--unit m"),
        (["pair.yml", "--swap"], "without --swap"),
        (["pair.yml", "--lens", "fisheye"], "4 coefficients of a fisheye"),
        (["pair.yml", "--name", "a/b"], "a name that a file may have"),
        ([], "expected calibration files"),
    ]:
        assert run("import", "stereo", *words, "--out", "head.toml") == 2, words
        error = capsys.readouterr().err
        assert said in error
        assert len(error.splitlines()) == 1
        assert not (tmp_path / "head.toml").exists()


def test_a_mistake_in_the_input_is_told_before_one_in_the_output(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_opencv(tmp_path / "pair.yml", opencv_pair())
    (tmp_path / "head.toml").write_text("mine", encoding="utf-8")
    for words, said in ((["none.yml"], "none.yml"), (["pair.yml"], "--force")):
        assert run("import", "stereo", *words, "--no-figure") == 2  # to head.toml by default
        assert said in capsys.readouterr().err
    assert (tmp_path / "head.toml").read_text(encoding="utf-8") == "mine"
    assert run("import", "stereo", "pair.yml", "--no-figure", "--force") == 0
    assert load_head(tmp_path / "head.toml").name == "head"


SQUARE_M = 0.02423
BOARD = (9, 6)


@pytest.fixture(scope="module")
def views() -> dict[int, np.ndarray]:
    """(2, 54, 2) corners of the board in both images, by the number of the view."""
    if not SHARED.is_dir():
        pytest.skip(f"the photographs are not here: {SHARED}")
    found = {}
    for number in range(1, 30):
        corners = []
        for eye in ("left", "right"):
            image = cv2.imread(str(SHARED / f"{eye}{number}.jpg"), cv2.IMREAD_GRAYSCALE)
            ok, rough = cv2.findChessboardCorners(image, BOARD)
            if ok:
                # the window sees one corner only: a fixed one merges those of small boards
                grid = rough.reshape(BOARD[1], BOARD[0], 2)
                steps = [np.linalg.norm(np.diff(grid, axis=axis), axis=2) for axis in (0, 1)]
                half = int(np.clip(min(s.min() for s in steps) / 3.0, 2, 5))
                stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
                fine = cv2.cornerSubPix(image, rough, (half, half), (-1, -1), stop)
                corners.append(fine.reshape(-1, 2))
        if len(corners) == 2:
            found[number] = np.stack(corners)
    return found


@pytest.mark.parametrize(("model", "remainder"), [("5 coefficients", 0), ("rational", 1)])
def test_a_real_pair_measures_the_squares_of_views_that_it_was_not_calibrated_on(
    tmp_path, views, model, remainder
):
    board = np.zeros((54, 3), np.float32)
    board[:, :2] = SQUARE_M * np.mgrid[0:9, 0:6].T.reshape(-1, 2)
    known = [view for number, view in views.items() if number % 2 == remainder]
    assert len(known) >= 14
    size, flags = (640, 360), 0 if model == "5 coefficients" else cv2.CALIB_RATIONAL_MODEL
    boards = [board] * len(known)
    points = [[np.ascontiguousarray(view[eye], np.float32) for view in known] for eye in (0, 1)]
    single = [cv2.calibrateCamera(boards, p, size, None, None, flags=flags)[1:3] for p in points]
    _, k1, d1, k2, d2, R, T, *_ = cv2.stereoCalibrate(
        boards, *points, *single[0], *single[1], size,
        flags=flags | cv2.CALIB_USE_INTRINSIC_GUESS,
    )  # fmt: skip
    path = write_opencv(
        tmp_path / "pair.yml",
        {"cameraMatrix1": k1, "distCoeffs1": d1, "cameraMatrix2": k2, "distCoeffs2": d2,
         "R": R, "T": T, "image_width": size[0], "image_height": size[1]},
    )  # fmt: skip
    assert run("import", "stereo", path, "--out", tmp_path / "head.toml", "--no-figure") == 0
    head = load_head(tmp_path / "head.toml")
    distances = []
    for number, view in views.items():
        if number % 2 != remainder:
            fix = triangulate_views(head, head.rest(), view.transpose(1, 0, 2))
            assert fix.valid.all()
            grid = fix.point.reshape(BOARD[1], BOARD[0], 3)
            distances += [np.linalg.norm(np.diff(grid, axis=a), axis=2).ravel() for a in (0, 1)]
    mean = float(np.concatenate(distances).mean())
    assert mean == pytest.approx(SQUARE_M, rel=0.002)


@pytest.mark.slow
def test_fisheyes_of_two_sizes_are_imported_as_they_are(tmp_path):
    four = {f"distCoeffs{i}": np.array([[0.02, -0.01, 2e-3, -1e-3]]) for i in (1, 2)}
    values = opencv_pair(
        **four, image_width=None, image_height=None, imageSize1=np.array([640, 480]),
        imageSize2=np.array([800, 600]), fisheye_model=1,
    )  # fmt: skip
    path = write_opencv(tmp_path / "pair.yml", values)
    assert run("import", "stereo", path, "--out", tmp_path / "head.toml") == 0
    head = load_head(tmp_path / "head.toml")
    assert head.cameras.size.tolist() == [[640, 480], [800, 600]]
    points = np.array([[0.4, -0.2, 0.5], [-0.3, 0.3, 0.6]])
    pixels = [
        cv2.fisheye.projectPoints(points[:, None], rotation, t, k, values["distCoeffs1"].T)[0]
        for rotation, t, k in (
            (np.zeros(3), np.zeros(3), K_LEFT),
            (cv2.Rodrigues(R)[0], T, K_RIGHT),
        )
    ]
    views = np.stack([one.reshape(-1, 2) for one in pixels], axis=1)
    T_N_Cl = head.camera_poses(head.rest())[0]
    fix = triangulate_views(head, head.rest(), views)
    np.testing.assert_allclose(fix.point, points @ T_N_Cl[:3, :3].T + T_N_Cl[:3, 3], atol=1e-9)
