"""`vergence import urdf`: options as people give them, a file written whole or not at all."""

import re

import pytest

from tests.commands.called import run
from tests.models.urdf.descriptions import NECK, eye, urdf
from vergence.models.head_file import load_head


@pytest.fixture
def robot(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "robot.urdf"
    path.write_text(urdf(NECK, eye("left"), eye("right")), encoding="utf-8")
    return path


IMPORT = ("import", "urdf", "robot.urdf", "--base", "base")
CAMERAS = ("--left-camera", "left_optical", "--right-camera", "right_optical")
WHOLE = (*CAMERAS, "--neck", "yaw", "roll", "pitch", "--out", "head.toml")


def test_it_writes_a_head_and_says_what_it_has_read_and_assumed(robot, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    code, out, err = run(capsys, *IMPORT, *WHOLE, "--no-figure")
    assert (code, err) == (0, "")
    assert load_head("head.toml").joints == (
        "yaw", "roll", "pitch", "left_pan", "left_tilt", "right_pan", "right_tilt",
    )  # fmt: skip
    for said in ("left_tilt -34.4 to 34.4", "lag 30 ms", "left out", "head.toml"):
        assert said in out
    assert len(out.splitlines()) <= 12
    counts = [int(count) for count in re.findall(r"^assumed, [\w ]+ \((\d+)\)", out, re.M)]
    assert len(counts) == 4
    assert sum(counts) == len(load_head("head.toml").assumptions)


@pytest.mark.nightly
def test_it_draws_the_head_beside_the_file(robot, capsys):
    code, out, _ = run(capsys, *IMPORT, *WHOLE)
    assert code == 0
    assert (robot.parent / "head.png").read_bytes().startswith(b"\x89PNG")
    assert "head.png" in out


def test_joints_are_locked_at_once_or_one_after_the_other(robot, capsys):
    for number, locks in enumerate((("--lock", "yaw=10", "roll=-20"),
                                    ("--lock=yaw=10", "--lock=roll=-20"))):  # fmt: skip
        out = f"head{number}.toml"
        words = (*CAMERAS, "--neck", "pitch", *locks, "--out", out, "--no-figure")
        assert run(capsys, *IMPORT, *words)[0] == 0, locks
        assert load_head(out).joints[:3] == ("pitch", "", "")


def test_axes_may_begin_with_a_minus(robot, capsys):
    bodies = ("--left-camera", "left_camera", "--right-camera", "right_camera")
    words = (*bodies, "--neck", "yaw", "roll", "pitch", "--out", "head.toml", "--no-figure")
    code, _, err = run(capsys, *IMPORT, *words)
    assert code == 2
    assert "--camera-axes=-y,-z,x would fit" in err
    assert not (robot.parent / "head.toml").exists()
    assert run(capsys, *IMPORT, *words, "--camera-axes", "-y,-z,x")[0] == 0
    assert run(capsys, *IMPORT, *words, "--camera-axes=-y,-z,x", "--force")[0] == 0


def test_each_eye_has_its_camera_and_one_for_both_is_marked(robot, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "160")
    for name, focal in (("l.yaml", 700), ("r.yaml", 710)):
        (robot.parent / name).write_text(
            "image_width: 800\nimage_height: 600\ndist_coeffs: [0, 0, 0, 0, 0]\n"
            f"camera_matrix: [[{focal}, 0, 400], [0, {focal}, 300], [0, 0, 1]]\n",
            encoding="utf-8",
        )
    words = (*WHOLE, "--no-figure", "--force", "--intrinsics", "l.yaml")
    code, _, err = run(capsys, *IMPORT, *words, "r.yaml")
    assert (code, err) == (0, "")
    head = load_head("head.toml")
    assert head.cameras.focal[:, 0].tolist() == [700.0, 710.0]
    assert not [key for key in head.assumptions if key.startswith("eyes")]
    code, out, _ = run(capsys, *IMPORT, *words)
    assert code == 0
    assert "focal 700, 700 px" in out
    why = "one calibration was given for both cameras"
    assert load_head("head.toml").assumptions["eyes.right.focal_px"] == why


def test_a_file_is_not_replaced_unless_forced(robot, capsys):
    (robot.parent / "head.toml").write_text("mine", encoding="utf-8")
    code, _, err = run(capsys, *IMPORT, *WHOLE, "--no-figure")
    assert code == 2
    assert "--force" in err
    assert (robot.parent / "head.toml").read_text(encoding="utf-8") == "mine"
    assert run(capsys, *IMPORT, *WHOLE, "--no-figure", "--force")[0] == 0


@pytest.mark.slow
def test_a_mistake_is_one_line_and_leaves_nothing(robot, capsys):
    for words, said in [
        (("--base", "bsae"), "base: expected a frame of the file (near: base"),
        (("--lock", "jaw"), "lock: expected JOINT=DEG, got 'jaw'"),
        (("--out", "head.yaml"), "out: expected a name that ends in .toml"),
        (("--name", "a/b"), "name: expected"), (("--actuators", "tilt"), "actuators"),
        (("--intrinsics", "none.yaml"), "none.yaml"),
    ]:  # fmt: skip
        code, _, err = run(capsys, *IMPORT, *WHOLE, "--no-figure", *words)
        assert code == 2, words
        assert len(err.splitlines()) == 1
        assert said in err
        assert [path.name for path in robot.parent.iterdir()] == ["robot.urdf"]
    code, _, err = run(capsys, *IMPORT, "--left-camera", "left_optical", "--out", "head.toml")
    assert code == 2
    assert "vergence needs two cameras" in err
