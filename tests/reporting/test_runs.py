"""Run folders appear whole or not at all."""

import errno

import pytest

from vergence.errors import ConfigurationError
from vergence.reporting import runs
from vergence.reporting.runs import (
    check_folder_free,
    locked_run_folder,
    run_folder,
    save_run_at_free_path,
    write_json,
)


def test_a_folder_appears_when_its_content_is_complete(tmp_path):
    folder = tmp_path / "a" / "run"
    with run_folder(folder) as partial:
        (partial / "x").write_text("1")
        assert not folder.exists()
    assert (folder / "x").read_text() == "1"
    (tmp_path / "run").mkdir()
    with run_folder(tmp_path / "run") as partial:
        (partial / "x").write_text("1")
    assert (tmp_path / "run" / "x").exists()


def test_nothing_is_left_of_a_run_that_failed(tmp_path):
    def fail() -> None:
        with run_folder(tmp_path / "run") as partial:
            (partial / "x").write_text("1")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert list(tmp_path.iterdir()) == []


def test_json_never_holds_what_json_has_no_word_for(tmp_path):
    with pytest.raises(ValueError, match="JSON"):
        write_json(tmp_path / "x.json", {"a": float("nan")})
    assert not (tmp_path / "x.json").exists()


def claim(folder) -> None:
    with locked_run_folder(folder):
        pass


def test_a_folder_is_held_from_before_the_work_to_its_end(tmp_path):
    with locked_run_folder(tmp_path / "run"):
        with pytest.raises(ConfigurationError, match="is writing"):
            claim(tmp_path / "run")
        save_run_at_free_path(tmp_path / "run", lambda folder: (folder / "x").touch())
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_a_folder_that_was_written_while_one_waited_for_it_is_refused(tmp_path, monkeypatch):
    checks = iter([lambda folder: (folder / "theirs").mkdir(parents=True), check_folder_free])
    monkeypatch.setattr(runs, "check_folder_free", lambda folder: next(checks)(folder))
    with pytest.raises(ConfigurationError, match="theirs"):
        claim(tmp_path / "run")


def test_a_result_that_cannot_be_written_is_called_lost_with_its_place_and_the_reason(tmp_path):
    def write(_folder) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(ConfigurationError, match=r"lost.*run.*No space left") as lost:
        save_run_at_free_path(tmp_path / "run", write)
    assert "\n" not in str(lost.value)
    assert list(tmp_path.iterdir()) == []


def test_the_run_folder_of_a_command_is_called_that(tmp_path):
    for sign, command in [
        ("trajectory.parquet", "gaze"), ("trajectory.csv", "gaze"), ("evaluation.json", "evaluate"),
        ("checkpoints", "train"), ("tune.json", "tune"), ("study.db", "tune"),
        ("experiments", "reproduce"),
    ]:  # fmt: skip
        folder = tmp_path / sign.replace(".", "-")
        folder.mkdir()
        (folder / sign).touch()
        said = f"got the run folder of vergence {command}"
        with pytest.raises(ConfigurationError, match=said):
            check_folder_free(folder)


def test_a_file_in_the_way_or_in_another_folder_is_named(tmp_path):
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(ConfigurationError, match=r"a folder with thesis\.tex in it"):
        check_folder_free(tmp_path)
    (tmp_path / "run").write_text("mine")
    with pytest.raises(ConfigurationError, match="a file"), run_folder(tmp_path / "run"):
        pass
    assert (tmp_path / "run").read_text() == "mine"


def test_a_name_that_no_folder_can_have_is_refused(tmp_path):
    for name in ("x" * 5000, "nul\0in it"):
        with pytest.raises(ConfigurationError, match="out: expected a folder"):
            check_folder_free(tmp_path / name)
