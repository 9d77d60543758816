"""Run folders appear whole or not at all."""

import pytest

from vergence.errors import ConfigurationError
from vergence.eval.reporting.runs import run_folder, write_json


def test_a_folder_appears_when_its_content_is_complete(tmp_path):
    folder = tmp_path / "a" / "run"
    with run_folder(folder) as partial:
        (partial / "x").write_text("1")
        assert not folder.exists()
    assert (folder / "x").read_text() == "1"


def test_nothing_is_left_of_a_run_that_failed(tmp_path):
    def fail() -> None:
        with run_folder(tmp_path / "run") as partial:
            (partial / "x").write_text("1")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert list(tmp_path.iterdir()) == []


def test_an_empty_folder_may_be_used(tmp_path):
    (tmp_path / "run").mkdir()
    with run_folder(tmp_path / "run") as partial:
        (partial / "x").write_text("1")
    assert (tmp_path / "run" / "x").exists()


def test_a_file_in_the_way_is_named(tmp_path):
    (tmp_path / "run").write_text("mine")
    with pytest.raises(ConfigurationError, match="a file"), run_folder(tmp_path / "run"):
        pass
    assert (tmp_path / "run").read_text() == "mine"


def test_json_never_holds_what_json_has_no_word_for(tmp_path):
    with pytest.raises(ValueError, match="JSON"):
        write_json(tmp_path / "x.json", {"a": float("nan")})
    assert not (tmp_path / "x.json").exists()
