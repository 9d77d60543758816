"""The run folder of a command: held while it works, saved somewhere or said to be lost."""

import errno
import json
from pathlib import Path

import pytest

from tests.commands.called import call, refused
from tests.naming import named
from vergence.eval import gaze_figure
from vergence.files import hold_lock

GAZE = ("gaze", "--plant", "kinematic", "--duration", "0.1", "--json")


@pytest.mark.slow
def test_a_place_that_another_holds_is_refused_at_once(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for words in [
        ("gaze", "--out", "R"), ("evaluate", "ibvs", "--out", "R"),
        ("reproduce", "time-response", "--quick", "--out", "R"), ("train", "policy", "--out", "R"),
        ("train", "--resume", "R"), ("export", "mjcf", "--out", "R"),
        ("export", "urdf", "--out", "R"), ("export", "bundle", "run", "R.vgp"),
    ]:  # fmt: skip
        with named(words):
            with hold_lock(Path("R.vgp" if "R.vgp" in words else "R")):
                before = sorted(tmp_path.rglob("*"))
                line = refused(capsys, *words)
                assert sorted(tmp_path.rglob("*")) == before
            assert "is writing" in line
            assert str(tmp_path / "R") in line
            assert list(tmp_path.iterdir()) == []


def test_a_result_goes_beside_a_place_taken_meanwhile(tmp_path, capsys, monkeypatch):
    def draw_while_somebody_comes(*_args: object) -> None:
        (tmp_path / "R").mkdir()
        (tmp_path / "R" / "theirs").touch()

    monkeypatch.setattr(gaze_figure, "draw_gaze", draw_while_somebody_comes)
    call("gaze", "--plant", "kinematic", "--out", tmp_path / "R")
    out, err = capsys.readouterr()
    assert f"{tmp_path / 'R'} has been taken meanwhile" in err
    assert f"written to {tmp_path / 'R-2'}\n" in out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["R", "R-2"]
    assert (tmp_path / "R-2" / "result.json").exists()
    assert [path.name for path in (tmp_path / "R").iterdir()] == ["theirs"]


def test_a_result_that_cannot_be_written_is_said_to_be_lost(tmp_path, capsys, monkeypatch):
    def fail(*_args: object) -> None:
        raise OSError(errno.ENOSPC, "the disk says no")

    monkeypatch.setattr(gaze_figure, "draw_gaze", fail)
    assert call(*GAZE, "--out", tmp_path / "R") == 2
    out, err = capsys.readouterr()
    assert json.loads(out)["plant"] == "kinematic"
    (line,) = err.splitlines()
    assert line.startswith("vergence: error: ")
    assert "lost" in line
    assert str(tmp_path / "R") in line
    assert "the disk says no" in line
    assert list(tmp_path.iterdir()) == []


def test_an_interruption_after_the_end_says_what_is_written(tmp_path, capsys, monkeypatch):
    def interrupt(*_args: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(gaze_figure, "draw_gaze", lambda *_: None)
    monkeypatch.setattr("vergence.commands.gaze._print_gaze", interrupt)
    assert call("gaze", "--plant", "kinematic", "--out", tmp_path / "R") == 130
    assert f"interrupted: {tmp_path / 'R'} is written" in capsys.readouterr().err


def test_an_interruption_before_the_end_writes_nothing(tmp_path, capsys, monkeypatch):
    def interrupt(*_args: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(gaze_figure, "draw_gaze", interrupt)
    assert call(*GAZE, "--out", tmp_path / "R") == 130
    assert capsys.readouterr().err == "vergence: interrupted: nothing was written\n"
    assert list(tmp_path.iterdir()) == []


def test_out_on_the_run_folder_of_another_command_says_what_it_is(tmp_path, capsys):
    (tmp_path / "trajectory.parquet").touch()
    (tmp_path / "config.toml").touch()
    for words in (["evaluate"], ["reproduce"], ["tune", "ibvs"], ["train", "policy"]):
        assert "got the run folder of vergence gaze" in refused(capsys, *words, "--out", tmp_path)
