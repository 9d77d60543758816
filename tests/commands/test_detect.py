"""`vergence detect`: single photographs, and a video in place of a camera."""

import json

import cv2
import numpy as np
import pytest

from tests.commands.called import call, refused
from tests.models.files.pairs import opencv_pair, write_opencv
from tests.naming import named
from tests.perception.drawn import Studio, pose_at
from vergence.models import load_head
from vergence.vision.targets import AprilTag, Checkerboard

TAG, BOARD = AprilTag(id=5, edge_m=0.12), Checkerboard(columns=5, rows=4, square_m=0.03)


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


@pytest.mark.slow
def test_json_has_a_row_for_each_target_of_an_image(folder, capsys):
    words = ("--target", "tag:36h11", "--target", "checkerboard:5x4", "--json")
    assert call("detect", folder, *words, "--head", "physical", "--eye", "left") == 0
    rows = json.loads(capsys.readouterr().out)
    assert [(row["image"], row["target"], row["id"]) for row in rows] == [
        (str(folder / "board.png"), "checkerboard:5x4", None),
        (str(folder / "tag.png"), "tag:36h11:5", 5),
    ]
    head = load_head("physical")
    pose = pose_at([0.02, 0.0, 0.6], [0.2, 0.1, 0.0])
    for row, target in zip(rows, (BOARD, TAG), strict=True):
        middle = pose[:3, :3] @ [*target.corners_m.mean(axis=0), 0.0] + pose[:3, 3]
        true = head.project(head.rest(), middle)[0]
        # a detector's bias is a few hundredths of a pixel beyond its noise
        np.testing.assert_allclose(row["centre_px"], true, atol=0.1)
        assert np.shape(row["corners_px"]) == np.shape(row["corners_sigma_px"])
        assert np.shape(row["corners_px"]) == (len(target.corners_m), 2)
        assert 0.0 < min(row["sigma_px"]) < 0.1
        # of unknown size: the rotation holds, and no length
        assert row["pose"]["translation_mm"] is row["pose"]["sigma_mm"] is None
        turned = np.linalg.inv(head.camera_poses(head.rest())[0])[:3, :3] @ pose[:3, :3]
        np.testing.assert_allclose(row["pose"]["rotation_matrix"], turned, atol=0.01)
    call("detect", folder / "tag.png", "--target", "tag:36h11", "--json")
    (row,) = json.loads(capsys.readouterr().out)
    assert row["pose"] is None


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


@pytest.mark.slow
def test_a_calibration_may_give_the_lens(folder, capsys, tmp_path):
    pair = write_opencv(tmp_path / "pair.yml", opencv_pair())
    words = ("detect", folder / "tag.png", "--target", "tag:36h11:5:120", "--camera", pair)
    assert call(*words, "--eye", "right") == 0
    capsys.readouterr()
    assert "expected left or right, as" in refused(capsys, *words)


@pytest.mark.slow
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
    for number in range(30):
        image = studio.take(pose, rng)[0]
        frame = np.full_like(image, 110) if number % 3 == 0 else image
        writer.write(cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR))
    writer.release()
    return path


@pytest.mark.slow
def test_live_tells_rate_noise_and_the_detectors_own_sigma(video, capsys):
    assert call("detect", "--live", video, "--target", "tag:36h11:5:120", "--json") == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["images"] == 30
    (tag,) = summary["targets"]
    assert (tag["target"], tag["id"]) == ("tag:36h11:5:120", 5)
    assert tag["detection_rate"] == pytest.approx(2.0 / 3.0)
    assert 0.0 < max(tag["noise_px"]) < 0.2
    assert 0.0 < max(tag["sigma_px"]) < 0.2
    assert call("detect", "--live", video, "--target", "tag:36h11") == 0
    out = capsys.readouterr().out
    for word in ("30 images", "images a second", "tag:36h11:5", "67%", "noise", "sigma"):
        assert word in out


@pytest.mark.slow
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
def test_live_ends_when_its_time_is_over_or_by_ctrl_c(video, capsys, monkeypatch):
    words = ("detect", "--live", video, "--target", "tag:36h11:5:120", "--json")
    call(*words, "--seconds", "1e-6")  # the tag is not in the first image
    assert json.loads(capsys.readouterr().out)["images"] == 1
    from vergence.perception import finding

    add, seen = finding.LiveStatistics.add, []

    def interrupted(self, *measured):
        add(self, *measured)
        seen.append(measured)
        if len(seen) == 10:
            raise KeyboardInterrupt

    monkeypatch.setattr(finding.LiveStatistics, "add", interrupted)
    assert call(*words) == 0
    assert json.loads(capsys.readouterr().out)["images"] == 10


@pytest.mark.slow
def test_what_cannot_be_is_refused_in_one_line(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cv2.imwrite("a.png", np.zeros((48, 64), np.uint8))
    (tmp_path / "folder.png").mkdir()
    write_opencv(tmp_path / "pair.yml", opencv_pair(image_width=None, image_height=None))
    (tmp_path / "text.avi").write_text("hello", encoding="utf-8")
    for words, said in (
        ([], "expected images or folders of images, or --live"),
        (["none.png"], "none.png: no such file or folder"),
        (["a.png", "--figure", "x.jpg"], "ends in .png"),
        # no such image either: the figure is looked at first
        (["none.png", "--figure", "nodir/x.png"], "figure: expected a file that can be written"),
        (["a.png", "--figure", "./a.png"], "another file than the images"),
        (["folder.png"], "got an empty one"),
        (["a.png", "--camera", "head.toml"], "(a head file is given as --head, with --eye left or"),
        (["a.png", "--head", "pair.yml", "--eye", "left"],
         "pair.yml: no head file; expected a TOML file, which vergence import stereo makes of a"),
        (["a.png", "--camera", "pair.yml", "--eye", "left"], "or give --size WIDTHxHEIGHT"),
        (["a.png", "--camera", "pair.yml", "--eye", "left", "--size", "640x480"],
         "expected the camera's 640 x 480 px, got 64 x 48"),
        (["a.png", "--size", "640x480"], "expected --camera beside it"),
        (["a.png", "--response", "rgb"], "response: expected 'linear', 'srgb', a gamma"),
        (["a.png", "--head", "physical"], "expected left or right"),
        (["a.png", "--eye", "left"], "expected --head or --camera"),
        (["a.png", "--live", "0"], "expected none with --live"),
        (["--live", "0", "--seconds", "0"], "expected more than 0"),
        (["--live", "none.avi"], "got 'none.avi': no such file"),
        (["--live", "a.png", "--head", "physical", "--eye", "left"], "the camera's 640 x 480 px"),
        (["--live", "text.avi"], "a video that OpenCV can read"),
    ):  # fmt: skip
        with named(words):
            assert said in refused(capsys, "detect", *words, "--target", "tag:36h11")
    assert "target: expected at least one" in refused(capsys, "detect", "a.png")


@pytest.mark.slow
def test_white_that_is_clipped_is_said(folder, capsys, tmp_path):
    image = cv2.imread(str(folder / "tag.png"), cv2.IMREAD_GRAYSCALE)
    bright = np.clip(2.0 * image.astype(float), 0, 255).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "bright.png"), bright)
    call("detect", tmp_path, "--target", "tag:36h11")
    assert "white is clipped in 1 of 1 image: its pixels" in capsys.readouterr().err
    call("detect", folder / "tag.png", "--target", "tag:36h11")
    assert "clipped" not in capsys.readouterr().err


def test_what_is_there_in_place_of_what_was_asked_for_is_said(folder, capsys):
    assert call("detect", folder / "tag.png", "--target", "tag:36h11:4") == 1
    assert capsys.readouterr().err.strip().endswith("tag:36h11:5 is there")
