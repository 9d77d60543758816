"""`vergence detect`: single photographs, and a video in place of a camera."""

import json

import cv2
import numpy as np
import pytest

from tests.models.files.pairs import opencv_pair, write_opencv
from tests.perception.drawn import Studio, pose_at
from vergence.cli import main
from vergence.models import load_head
from vergence.models.boards import AprilTag, CharucoBoard, Checkerboard
from vergence.vision import AprilGrid

TAG, BOARD = AprilTag(id=5, edge_m=0.12), Checkerboard(columns=5, rows=4, square_m=0.03)


def call(*words: object) -> int:
    with pytest.raises(SystemExit) as stopped:
        main([str(word) for word in words])
    return int(stopped.value.code or 0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A tag, a board and nothing, as the left eye of `physical` sees them at rest."""
    folder = tmp_path_factory.mktemp("images")
    head, rng = load_head("physical"), np.random.default_rng(0)
    for name, target in (("tag", TAG), ("board", BOARD)):
        image = Studio(head, target).take(pose_at([0.02, 0.0, 0.6], [0.2, 0.1, 0.0]), rng)[0]
        cv2.imwrite(str(folder / f"{name}.png"), image)
    cv2.imwrite(str(folder / "plain.png"), np.full((480, 640), 110, np.uint8))
    return folder


def test_json_has_a_row_for_each_target_of_an_image(folder, capsys):
    words = ("--target", "tag:36h11", "--target", "checkerboard:5x4", "--json")
    assert call("detect", folder, *words, "--head", "physical", "--eye", "left") == 0
    rows = json.loads(capsys.readouterr().out)
    assert [(row["image"], row["target"], row["id"]) for row in rows] == [
        (str(folder / "board.png"), "checkerboard:5x4", None),
        (str(folder / "tag.png"), "tag:36h11:5", 5),
    ]
    head = load_head("physical")
    poses = head.camera_poses(head.rest())
    pose = pose_at([0.02, 0.0, 0.6], [0.2, 0.1, 0.0])
    for row, target in zip(rows, (BOARD, TAG), strict=True):
        middle = pose[:3, :3] @ [*target.corners_m.mean(axis=0), 0.0] + pose[:3, 3]
        true = head.project(head.rest(), middle)[0]
        # a detector's bias is a few hundredths of a pixel beyond its noise
        np.testing.assert_allclose(row["centre_px"], true, atol=0.1)
        assert np.shape(row["corners_px"]) == np.shape(row["corners_sigma_px"])
        assert np.shape(row["corners_px"]) == (len(target.corners_m), 2)
        assert 0.0 < min(row["sigma_px"]) < 0.1
    assert poses.shape == (2, 4, 4)


@pytest.mark.slow
def test_the_table_and_the_figure_show_what_was_found(folder, capsys, tmp_path):
    figure = tmp_path / "found.png"
    words = ("--target", "tag:36h11:5:120", "--target", "checkerboard:5x4:30", "--figure", figure)
    assert call("detect", *sorted(folder.iterdir()), *words) == 0
    out, err = capsys.readouterr()
    for word in ("tag:36h11:5:120", "checkerboard:5x4:30", "20 of 20", "2 of 3 images"):
        assert word in out
    assert f"{figure} is written" in err
    assert min(cv2.imread(str(figure)).shape[:2]) > 300


def test_a_calibration_may_give_the_lens(folder, capsys, tmp_path):
    pair = write_opencv(tmp_path / "pair.yml", opencv_pair())
    words = ("detect", folder / "tag.png", "--target", "tag:36h11:5:120", "--camera", pair)
    assert call(*words, "--eye", "right") == 0
    capsys.readouterr()
    assert call(*words) == 2
    assert "expected left or right, as" in capsys.readouterr().err


def test_a_response_may_be_stated_and_colours_are_taken_for_srgb(folder, capsys, tmp_path):
    grey, colours = folder / "tag.png", tmp_path / "colours.png"
    cv2.imwrite(str(colours), cv2.imread(str(grey)))  # BGR

    def corners(*words: object) -> list[list[float]]:
        assert call("detect", *words, "--target", "tag:36h11", "--json") == 0
        return json.loads(capsys.readouterr().out)[0]["corners_px"]

    assert corners(colours) == corners(grey, "--response", "srgb") != corners(grey)
    assert corners(grey) == corners(colours, "--response", "0,0.5,1")


def test_nothing_found_ends_in_exit_code_1(folder, capsys):
    assert call("detect", folder / "plain.png", "--target", "tag:36h11", "--json") == 1
    out, err = capsys.readouterr()
    assert json.loads(out) == []
    assert "expected tag:36h11 in" in err


def test_broken_images_are_named_and_the_rest_goes_on(folder, capsys, tmp_path):
    for number in range(8):
        (tmp_path / f"{number}.png").write_bytes(b"broken")
    words = ("--target", "tag:36h11", "--json")
    assert call("detect", tmp_path, folder / "tag.png", *words) == 2
    out, err = capsys.readouterr()
    assert len(json.loads(out)) == 1
    assert str(tmp_path / "0.png") in err
    assert "and 3 more that could not be read" in err


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    """A still tag, away in each third image, with the camera's noise."""
    path = tmp_path_factory.mktemp("video") / "tag.avi"
    head, rng = load_head("physical"), np.random.default_rng(3)
    studio, pose = Studio(head, TAG), pose_at([0.0, 0.0, 0.7])
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"FFV1"), 30.0, (640, 480))
    if not writer.isOpened():
        pytest.skip("OpenCV has no lossless writer of videos here")
    for number in range(60):
        image = studio.take(pose, rng)[0]
        frame = np.full_like(image, 110) if number % 3 == 0 else image
        writer.write(cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR))
    writer.release()
    return path


@pytest.mark.slow
def test_live_tells_rate_noise_and_the_detectors_own_sigma(video, capsys):
    assert call("detect", "--live", video, "--target", "tag:36h11:5:120", "--json") == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["images"] == 60
    (tag,) = summary["targets"]
    assert (tag["target"], tag["id"]) == ("tag:36h11:5:120", 5)
    assert tag["detection_rate"] == pytest.approx(2.0 / 3.0)
    assert 0.0 < max(tag["noise_px"]) < 0.2
    assert 0.0 < max(tag["sigma_px"]) < 0.2


def test_a_target_that_no_image_has_is_named_beside_those_found(folder, capsys):
    words = ("--target", "tag:36h11:5", "--target", "tag:36h11:7", "--target", "checkerboard:7x4")
    assert call("detect", folder, *words, "--json") == 0
    out, err = capsys.readouterr()
    assert len(json.loads(out)) == 1
    assert err.splitlines() == [
        "vergence: tag:36h11:7: found in 0 of 3 images",
        "vergence: checkerboard:7x4: found in 0 of 3 images",
    ]


@pytest.mark.slow
def test_live_prints_a_summary_for_people_too(video, capsys):
    assert call("detect", "--live", video, "--target", "tag:36h11") == 0
    out = capsys.readouterr().out
    for word in ("60 images", "images a second", "tag:36h11:5", "67%", "noise", "sigma"):
        assert word in out


def test_live_ends_when_its_time_is_over_or_by_ctrl_c(video, capsys, monkeypatch):
    words = ("detect", "--live", video, "--target", "tag:36h11:5:120", "--json")
    call(*words, "--seconds", "1e-6")  # the tag is not in the first image
    assert json.loads(capsys.readouterr().out)["images"] == 1
    from vergence.perception import live

    add, seen = live.LiveStatistics.add, []

    def interrupted(self, *measured):
        add(self, *measured)
        seen.append(measured)
        if len(seen) == 10:
            raise KeyboardInterrupt

    monkeypatch.setattr(live.LiveStatistics, "add", interrupted)
    assert call(*words) == 0
    assert json.loads(capsys.readouterr().out)["images"] == 10


def test_what_cannot_be_is_refused_in_one_line(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cv2.imwrite("a.png", np.zeros((48, 64), np.uint8))
    (tmp_path / "folder.png").mkdir()
    write_opencv(tmp_path / "pair.yml", opencv_pair(image_width=None, image_height=None))
    (tmp_path / "text.avi").write_text("hello", encoding="utf-8")
    cases = [
        (["--target", "tag:36h11"], "expected images or folders of images, or --live"),
        (["a.png"], "target: expected at least one"),
        (["none.png", "--target", "tag:36h11"], "none.png: no such file or folder"),
        (["a.png", "--target", "tag"], "target: expected tag:FAMILY"),
        (["a.png", "--target", "tag:36h11", "--figure", "x.jpg"], "ends in .png"),
        (["a.png", "--target", "tag:36h11", "--figure", "nodir/x.png"],
         "figure: expected a file that can be written, got nodir/x.png: No such file"),
        (["a.png", "--target", "tag:36h11", "--figure", "folder.png"], "Is a directory"),
        (["a.png", "--target", "tag:36h11", "--figure", "./a.png"], "another file than the images"),
        ([".", "--target", "tag:36h11", "--figure", "a.png"], "another file than the images"),
        (["a.png", "nodir", "--target", "tag:36h11"], "nodir: no such file or folder; expected an"),
        (["folder.png", "--target", "tag:36h11"], "got an empty one"),
        (["a.png", "--target", "tag:36h11", "--camera", "head.toml"],
         "got head.toml (a head file is given as --head, with --eye left or right)"),
        (["a.png", "--target", "tag:36h11", "--head", "pair.yml", "--eye", "left"],
         "pair.yml: no head file; expected a TOML file, which vergence import stereo makes of a"),
        (["a.png", "--target", "tag:36h11", "--camera", "pair.yml", "--eye", "left"],
         "or give --size WIDTHxHEIGHT"),
        (["a.png", "--target", "tag:36h11", "--camera", "pair.yml", "--eye", "left",
          "--size", "640x480"], "expected the camera's 640 x 480 px, got 64 x 48"),
        (["a.png", "--target", "tag:36h11", "--size", "640x480"], "expected --camera beside it"),
        (["a.png", "--target", "tag:36h11", "--response", "rgb"],
         "response: expected 'linear', 'srgb', a gamma"),
        (["a.png", "--target", "tag:36h11", "--seconds", "3"], "expected only with --live"),
        (["a.png", "--target", "tag:36h11", "--head", "physical"], "expected left or right"),
        (["a.png", "--target", "tag:36h11", "--eye", "left"], "expected --head or --camera"),
        (["a.png", "--target", "tag:36h11", "--live", "0"], "expected none with --live"),
        (["--live", "0", "--target", "tag:36h11", "--seconds", "0"], "expected more than 0"),
        (["--live", "99", "--target", "tag:36h11"], "got 99: no such device"),
        (["--live", "/dev/none", "--target", "tag:36h11"], "got /dev/none: no such device"),
        (["--live", "none.avi", "--target", "tag:36h11"], "got 'none.avi': no such file"),
        (["--live", "a.png", "--target", "tag:36h11:5", "--head", "physical", "--eye", "left"],
         "expected the camera's 640 x 480 px"),
        (["--live", "text.avi", "--target", "tag:36h11"], "a video that OpenCV can read"),
    ]  # fmt: skip
    for words, said in cases:
        assert call("detect", *words) == 2, words
        out, err = capsys.readouterr()
        assert out == ""
        assert len(err.strip().splitlines()) == 1
        assert said in err


def test_a_figure_that_cannot_be_written_is_refused_before_the_work(capsys, tmp_path):
    # no such image either: the figure is looked at first
    words = ("detect", tmp_path / "none.png", "--target", "tag:36h11", "--figure")
    assert call(*words, tmp_path / "nodir" / "x.png") == 2
    assert "figure: expected a file that can be written" in capsys.readouterr().err
    assert call("info", "--head", "physical", "--figure", tmp_path / "nodir" / "x.png") == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert "figure: expected a file that can be written" in err
    assert list(tmp_path.iterdir()) == []


def test_a_board_of_the_old_layout_is_named_so(capsys, tmp_path):
    board = CharucoBoard(columns=6, rows=4, square_m=0.03, marker_m=0.022, legacy=True)
    image = Studio(load_head("physical"), board).take(
        pose_at([0.0, 0.0, 0.5]), np.random.default_rng(0)
    )[0]
    cv2.imwrite(str(tmp_path / "a.png"), image)
    for text in ("charuco:6x4:30:22:4X4_50", "charuco:6x4:30:22:4X4_50:legacy"):
        # of the other target nothing is found; the board counts as found by either text
        words = ("--target", text, "--target", "tag:36h11:5", "--json")
        assert call("detect", tmp_path / "a.png", *words) == 0
        out, err = capsys.readouterr()
        (row,) = json.loads(out)
        assert row["target"] == "charuco:6x4:30:22:4X4_50:legacy"
        assert err.splitlines() == ["vergence: tag:36h11:5: found in 0 of 1 image"]
    for command in ("detect", "locate"):
        assert call(command, "--help") == 0
        out = " ".join(capsys.readouterr().out.replace("│", " ").split())
        assert "DICT[:legacy]" in out


def test_an_april_grid_is_found_by_kalibrs_words(capsys, tmp_path):
    grid = AprilGrid(columns=4, rows=3, tag_m=0.04, spacing=0.25)
    image = Studio(load_head("physical"), grid).take(
        pose_at([0.0, 0.0, 0.5]), np.random.default_rng(0)
    )[0]
    cv2.imwrite(str(tmp_path / "a.png"), image)
    assert call("detect", tmp_path / "a.png", "--target", "aprilgrid:4x3:40:0.25") == 0
    assert "48 of 48" in capsys.readouterr().out
    assert call("detect", tmp_path / "a.png", "--target", "aprilgrid:3x4:40:0.25") == 1
    assert "aprilgrid:4x3:40:0.25 (tags," in capsys.readouterr().err


def test_white_that_is_clipped_is_said(folder, capsys, tmp_path):
    image = cv2.imread(str(folder / "tag.png"), cv2.IMREAD_GRAYSCALE)
    bright = np.clip(2.0 * image.astype(float), 0, 255).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "bright.png"), bright)
    assert call("detect", tmp_path, "--target", "tag:36h11") == 0
    assert "white is clipped in 1 of 1 image: its pixels" in capsys.readouterr().err
    assert call("detect", folder, "--target", "tag:36h11") == 0
    assert "clipped" not in capsys.readouterr().err


def test_what_is_there_in_place_of_what_was_asked_for_is_said(folder, capsys):
    for asked, image, there in [
        ("checkerboard:6x5:30", "board.png", "checkerboard:5x4:30 (inner corners) is there"),
        ("tag:36h11:4", "tag.png", "tag:36h11:5 is there"),
        ("tag:25h9", "tag.png", "tag:36h11:5 is there"),
        ("tag:36h11", "plain.png", "found none"),
    ]:
        assert call("detect", folder / image, "--target", asked) == 1, asked
        assert capsys.readouterr().err.strip().endswith(there)
