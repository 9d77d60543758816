"""`vergence locate`: what it prints and writes, and how it refuses."""

import csv
import json
import re
import tomllib

import cv2
import numpy as np
import pytest

from tests.heads import text_of
from tests.perception.drawn import Studio, corners_in_space, pose_at, save_pair
from vergence.cli import main
from vergence.models import load_head
from vergence.models.boards import AprilTag

TARGET = "tag:36h11:5:120"
TAG = AprilTag(id=5, edge_m=0.12)


def call(*words: object) -> int:
    with pytest.raises(SystemExit) as stopped:
        main([str(word) for word in words])
    return int(stopped.value.code or 0)


@pytest.fixture(scope="module")
def desk(tmp_path_factory):
    """A fixed pair's head file, and three pairs of a tag; in the third one its place is empty."""
    folder = tmp_path_factory.mktemp("desk")
    (folder / "pair.toml").write_text(text_of("pair"), encoding="utf-8")
    head = load_head(folder / "pair.toml")
    studio, rng = Studio(head, TAG), np.random.default_rng(0)
    poses = [pose_at([0.02, -0.03, 0.6], [0.1, 0.3, 0.0]), pose_at([-0.05, 0.02, 0.8], [0, 0, 0.4])]
    for number, pose in zip((2, 10), poses, strict=True):
        save_pair(folder, f"{number}.png", studio.take(pose, rng))
    save_pair(folder, "11.png", [np.full((240, 320), 120, np.uint8)] * 2)
    return folder, poses


@pytest.fixture
def undrawn(monkeypatch):
    """Run folders without a picture, which takes longer than the rest."""
    monkeypatch.setattr("vergence.eval.reporting.locate_figure.draw_located", lambda *_: None)


def located(desk, capsys, *words):
    folder, _ = desk
    assert call("locate", folder / "left", folder / "right", "--head", folder / "pair.toml",
                "--target", TARGET, "--json", *words) == 0  # fmt: skip
    return json.loads(capsys.readouterr().out)


@pytest.mark.usefixtures("undrawn")
def test_json_has_a_row_for_each_target_of_a_pair_with_the_true_points(desk, capsys, tmp_path):
    rows = located(desk, capsys, "--out", tmp_path / "run")
    assert [row["pair"] for row in rows] == ["2.png", "10.png"]
    for row, pose in zip(rows, desk[1], strict=True):
        assert (row["target"], row["id"]) == (TARGET, 5)
        sigma = np.array(row["sigma_mm"])
        error = np.array(row["points_mm"]) - 1e3 * corners_in_space(TAG, pose)
        # 12 coordinates of each: beyond four sigma is no chance
        assert (np.abs(error) < 4.0 * sigma).all()
        assert (sigma > 0.0).all()
        assert np.abs(np.array(row["centre_mm"]) - 1e3 * pose[:3, 3]).max() < 3.0
        assert np.shape(row["pixels"]) == np.shape(row["sigma_px"]) == (2, 4, 2)
        assert np.shape(row["gap_mm"]) == (4,)
        assert row["spacing_mm"]["mean"] == pytest.approx(120.0, abs=0.5)
        assert row["spacing_mm"]["stated"] == 120.0


@pytest.mark.slow
def test_the_run_folder_holds_points_targets_result_config_head_and_picture(desk, capsys, tmp_path):
    rows = located(desk, capsys, "--out", tmp_path / "run")
    names = {path.name for path in (tmp_path / "run").iterdir()}
    assert names == {
        "points.csv", "targets.csv", "result.json", "config.toml", "head.toml", "locate.png",
    }  # fmt: skip
    result = json.loads((tmp_path / "run" / "result.json").read_text())
    assert result["located"] == rows
    assert result["pairs"] == ["2.png", "10.png", "11.png"]
    config = tomllib.loads((tmp_path / "run" / "config.toml").read_text())
    assert config["config"]["target"] == [TARGET]
    with (tmp_path / "run" / "points.csv").open(newline="") as file:
        points = list(csv.DictReader(file))
    assert len(points) == 8
    assert float(points[5]["z_mm"]) == rows[1]["points_mm"][1][2]
    assert float(points[5]["right_u_px"]) == rows[1]["pixels"][1][1][0]
    picture = cv2.imread(str(tmp_path / "run" / "locate.png"))
    assert min(picture.shape[:2]) > 700


@pytest.mark.slow
def test_the_table_shows_centre_sigma_gap_and_the_stated_edge(desk, capsys, tmp_path):
    folder, poses = desk
    pair = (folder / "left" / "2.png", folder / "right" / "2.png")
    words = ("--head", folder / "pair.toml", "--target", TARGET, "--out", tmp_path / "run")
    assert call("locate", *pair, *words) == 0
    out, err = capsys.readouterr()
    assert "tags of 36h11" in out
    for word in ("x", "centre", "sigma", "gap", "edge", "1 of 1 pairs", "stated 120 mm"):
        assert word in out
    numbers = [float(word) for word in re.findall(r"\d+\.\d+", out)]
    assert any(abs(number - 1e3 * poses[0][2, 3]) < 3.0 for number in numbers)
    assert err == ""


@pytest.mark.usefixtures("undrawn")
def test_a_head_that_moves_is_at_rest_unless_told_and_the_command_says_so(capsys, tmp_path):
    head = load_head("turrets")
    place = [0.1, 0.05, 0.7]
    q = head.fixate(place)
    images = Studio(head, TAG, q).take(pose_at(place), np.random.default_rng(1))
    pair = save_pair(tmp_path, "one.png", images)
    angles = {name: float(value) for name, value in zip(head.joints, q, strict=True) if name}
    (tmp_path / "q.json").write_text(json.dumps(angles), encoding="utf-8")
    words = ("locate", *pair, "--head", "turrets", "--target", TARGET, "--json", "--out")
    assert call(*words, tmp_path / "with", "--joints", tmp_path / "q.json") == 0
    out, err = capsys.readouterr()
    (row,) = json.loads(out)
    error = np.array(row["centre_mm"]) - 1e3 * np.array(place)
    assert (np.abs(error) < 3.0 * np.array(row["centre_sigma_mm"])).all()
    assert "rest" not in err
    call(*words, tmp_path / "without")
    out, err = capsys.readouterr()
    assert "no --joints: the eyes are taken to be at rest, in degrees" in err
    for row in json.loads(out):
        assert (
            row["centre_mm"] is None
            or np.abs(np.subtract(row["centre_mm"], 1e3 * np.array(place))).max() > 50.0
        )


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_what_one_image_alone_has_is_counted(desk, capsys, tmp_path):
    folder, _ = desk
    rights = tmp_path / "right"
    rights.mkdir()
    for name, image in (("2.png", "2.png"), ("10.png", "11.png"), ("12.png", "2.png")):
        (rights / name).write_bytes((folder / "right" / image).read_bytes())
    words = ("--head", folder / "pair.toml", "--target", TARGET, "--out", tmp_path / "run")
    assert call("locate", folder / "left", rights, *words) == 0
    err = capsys.readouterr().err
    assert f"{TARGET} found in the left image only of 1 pair: 10.png" in err
    assert "2 of the images have no partner: 11.png, 12.png" in err


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_broken_image_of_a_folder_is_named_and_the_rest_goes_on(desk, capsys, tmp_path):
    folder, _ = desk
    for side in ("left", "right"):
        (tmp_path / side).mkdir()
        for name in ("2.png", "10.png"):
            (tmp_path / side / name).write_bytes((folder / side / name).read_bytes())
    (tmp_path / "right" / "10.png").write_bytes(b"")
    words = ("--head", folder / "pair.toml", "--target", TARGET, "--json")
    both = (tmp_path / "left", tmp_path / "right")
    assert call("locate", *both, *words, "--out", tmp_path / "run") == 2
    out, err = capsys.readouterr()
    assert [row["pair"] for row in json.loads(out)] == ["2.png"]
    assert str(tmp_path / "right" / "10.png") in err
    (tmp_path / "left" / "2.png").write_bytes(b"no image")
    assert call("locate", *both, *words, "--out", tmp_path / "none") == 2
    err = capsys.readouterr().err
    assert "got none in 2 pairs; the first:" in err
    assert not (tmp_path / "none").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_nothing_found_ends_in_exit_code_1(desk, capsys, tmp_path):
    folder, _ = desk
    words = ("--head", folder / "pair.toml", "--target", "tag:36h11:6:120", "--json")
    code = call("locate", folder / "left", folder / "right", *words, "--out", tmp_path / "run")
    out, err = capsys.readouterr()
    assert code == 1
    assert json.loads(out) == []
    assert "expected tag:36h11:6:120 in both images of any of 3 pairs, found none" in err
    assert (tmp_path / "run" / "result.json").exists()


@pytest.mark.usefixtures("undrawn")
def test_swapped_images_are_told(desk, capsys, tmp_path):
    folder, _ = desk
    words = ("--head", folder / "pair.toml", "--target", TARGET, "--out", tmp_path / "run")
    pair = (folder / "right" / "2.png", folder / "left" / "2.png")
    assert call("locate", *pair, *words) == 1
    assert "are left and right swapped?" in capsys.readouterr().err


@pytest.mark.usefixtures("undrawn")
def test_images_that_do_not_belong_together_are_told(desk, capsys, tmp_path):
    folder, _ = desk
    words = ("--head", folder / "pair.toml", "--target", TARGET, "--out", tmp_path / "run")
    call("locate", folder / "left" / "2.png", folder / "right" / "10.png", *words)
    assert "lines of sight miss each other by more than 2 px" in capsys.readouterr().err


def test_what_cannot_be_is_refused_in_one_line(desk, capsys, tmp_path, monkeypatch):
    folder, _ = desk
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty.png").write_bytes(b"")
    (tmp_path / "text.png").write_bytes(b"hello")
    (tmp_path / "left").mkdir()
    cv2.imwrite("small.png", np.zeros((48, 64), np.uint8))
    for change, said in [
        ({"left": "none.png"}, "none.png: no such file"),
        ({"left": "empty.png"}, "empty.png: empty"),
        ({"left": "text.png"}, "text.png: no image"),
        (
            {"left": "small.png"},
            "small.png: image: expected the camera's 320 x 240 px, got 64 x 48",
        ),
        ({"left": "left"}, "two images or two folders"),
        ({"target": "tag:99h9"}, "target tag:99h9:"),
        ({"target": "board"}, "target: expected"),
        ({"head": "nonsense"}, "'nonsense'"),
        ({"joints": "none.json"}, "none.json: No such file"),
        ({"response": "9"}, "response: expected 'linear', 'srgb', a gamma"),
    ]:
        options = {
            "left": folder / "left" / "2.png", "right": folder / "right" / "2.png",
            "head": folder / "pair.toml", "target": TARGET, "joints": None,
        } | change  # fmt: skip
        words = [options.pop("left"), options.pop("right")]
        for name, value in options.items():
            words += [f"--{name}", value] if value is not None else []
        assert call("locate", *words) == 2, change
        out, err = capsys.readouterr()
        assert out == ""
        assert len(err.strip().splitlines()) == 1
        assert said in err
        assert not (tmp_path / "runs").exists()


def test_a_target_and_a_head_have_to_be_given(desk, capsys):
    folder, _ = desk
    pair = (folder / "left" / "2.png", folder / "right" / "2.png")
    assert call("locate", *pair, "--head", folder / "pair.toml") == 2
    assert "target: expected at least one" in capsys.readouterr().err
    assert call("locate", *pair, "--target", TARGET) == 2
    assert "--head" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_edges_that_are_not_as_stated_are_marked_and_said_with_the_likeliest_unit(
    desk, capsys, tmp_path
):
    folder, _ = desk
    words = ("locate", folder / "left", folder / "right", "--head", folder / "pair.toml")
    for size, off, hint in (
        ("120", False, ""),
        ("121", False, ""),  # 0.8 %: such a calibration is no mistake
        ("100", True, ""),
        ("0.12", True, "was the size given in m"),
        ("12", True, "was the size given in cm"),
        ("4.724", True, "was the size given in inches"),
        ("120000", True, "was the size given in micrometres"),
    ):
        call(*words, "--target", f"tag:36h11:5:{size}", "--out", tmp_path / size)
        out, err = capsys.readouterr()
        assert ("!" in out) == off
        line = [text for text in err.splitlines() if "edges are" in text]
        assert len(line) == off
        if off:
            assert f"in 2 of 2 places (2.png, 10.png), expected {float(size):g} ± " in line[0]
            assert "joint angles, the head's calibration or the size do not fit" in line[0]
            assert hint in line[0]
            assert ("was the size" in line[0]) == bool(hint)


@pytest.mark.usefixtures("undrawn")
def test_joint_angles_that_are_off_are_told_by_the_edges(capsys, tmp_path):
    head = load_head("turrets")
    q = head.fixate([0.1, 0.05, 0.7])
    images = Studio(head, TAG, q).take(pose_at([0.1, 0.05, 0.7]), np.random.default_rng(1))
    pair = save_pair(tmp_path, "one.png", images)
    words = ("locate", *pair, "--head", "turrets", "--target", TARGET)
    names = list(head.joints)
    for turn, told in ((0.0, False), (0.05, True)):
        turned = q.copy()
        turned[names.index("left_pan")] += turn  # along the gap it shows nowhere but in the depth
        angles = {name: float(value) for name, value in zip(names, turned, strict=True) if name}
        (tmp_path / "q.json").write_text(json.dumps(angles), encoding="utf-8")
        call(*words, "--joints", tmp_path / "q.json", "--out", tmp_path / f"{turn}", "--json")
        out, err = capsys.readouterr()
        assert ("edges are" in err) == told
        (row,) = json.loads(out)
        # of the joints' steps: far more than pixels alone would leave
        assert 0.1 < row["spacing_mm"]["sigma"] < 2.0


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_target_that_no_image_has_is_named_beside_those_found(desk, capsys, tmp_path):
    folder, _ = desk
    words = ("locate", folder / "left", folder / "right", "--head", folder / "pair.toml")
    targets = ("--target", "tag:36h11", "--target", TARGET, "--target", "tag:36h11:9")
    assert call(*words, *targets, "--out", tmp_path / "run") == 0
    err = capsys.readouterr().err
    assert "tag:36h11:9: found in 0 of 6 images" in err
    assert err.count("found in 0 of") == 1  # the family's tag is that of the second text as well


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_pairs_without_an_answer_do_not_count_as_located(desk, capsys, tmp_path):
    folder, _ = desk
    for side, other in (("left", "right"), ("right", "left")):
        (tmp_path / side).mkdir()
        for name, source in (("2.png", side), ("10.png", other)):  # the second is swapped
            image = (folder / source / name).read_bytes()
            (tmp_path / side / name).write_bytes(image)
    words = ("--head", folder / "pair.toml", "--target", TARGET, "--out", tmp_path / "run")
    assert call("locate", tmp_path / "left", tmp_path / "right", *words) == 0
    out, err = capsys.readouterr()
    assert "1 of 2 pairs; edges of tags 1" in out
    assert "nan" not in out
    assert "the lines of sight do not cross before the eyes in 10.png" in err
    result = json.loads((tmp_path / "run" / "result.json").read_text())
    assert [one["centre_mm"] is None for one in result["located"]] == [False, True]
    assert result["located"][1]["spacing_mm"]["sigma"] is None
