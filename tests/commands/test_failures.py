"""Failures of the operating system give one line and exit code 2, wherever they happen."""

import errno
import io
import os
import sys

import pytest

from tests.commands.called import call, refused
from tests.models.files.pairs import opencv_pair, write_opencv
from tests.naming import named
from vergence import cli
from vergence.cli import main


def test_an_error_of_the_machine_is_one_line(monkeypatch, capsys):
    cases = [
        (OSError(errno.ENOSPC, "No space left on device", "/tmp/x.bin"),
         "/tmp/x.bin: No space left on device"),
        (OSError(errno.EDQUOT, "Disk quota exceeded"), "Disk quota exceeded"),
        (OSError(errno.EIO, "Input/output error", b"/x\xff"), "Input/output error"),
        (OSError(errno.ENAMETOOLONG, "File name too long", "x" * 5000), "File name too long"),
        (OSError("Matplotlib requires access to a writable cache directory"), "Matplotlib"),
        (OSError(), "OSError"), (MemoryError(), "memory"),
    ]  # fmt: skip
    for error, said in cases:

        def fail(_words: list[str], error: BaseException = error) -> int:
            raise error

        monkeypatch.setattr(cli, "_run", fail)
        with named(error):
            assert said in refused(capsys, "info")


def test_words_that_are_no_text_are_refused(capsys):
    for word in ("nul\0in it", "not \udcff text"):
        assert "expected words of text" in refused(capsys, "gaze", "--out", word)


@pytest.mark.slow
def test_a_name_of_5000_characters_is_refused_in_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for words in [
        ("gaze", "--head"), ("gaze", "--out"), ("evaluate", "--out"), ("reproduce", "--config"),
        ("train", "--resume"), ("train", "policy", "--out"), ("tune", "ibvs", "--out"),
        ("export", "mjcf", "--out"), ("export", "bundle", "run"), ("evaluate",),
    ]:  # fmt: skip
        with named(words):
            refused(capsys, *words, "x" * 5000 + (".vgp" if "bundle" in words else ""))
            assert list(tmp_path.iterdir()) == []


class Full(io.RawIOBase):
    def writable(self) -> bool:
        return True

    def write(self, _data: object) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")


def test_output_to_a_full_disk_is_one_line(monkeypatch, capsys):
    stdout = io.TextIOWrapper(io.BufferedWriter(Full()), encoding="utf-8")
    monkeypatch.setattr(cli, "_run", lambda _words: print("x" * 10) or 0)
    with monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", stdout)
        assert call("info") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line == "vergence: error: No space left on device"
    with pytest.raises(OSError, match="No space"):
        stdout.close()


def test_a_result_whose_reader_has_gone_is_no_error(monkeypatch, capsys):
    read, write = os.pipe()
    os.close(read)
    stdout = os.fdopen(write, "w")
    monkeypatch.setattr(cli, "_run", lambda _words: print("x" * 10) or 0)
    with monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", stdout)
        assert call("info") == 0
    assert capsys.readouterr().err == ""
    stdout.close()


@pytest.mark.nightly
def test_files_are_written_before_a_reader_that_leaves_early_is_noticed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_opencv(tmp_path / "pair.yml", opencv_pair())
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w", buffering=1) as stdout, monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", stdout)
        call("import", "stereo", "pair.yml", "--out", "desk.toml")
    assert {path.name for path in tmp_path.iterdir()} == {"pair.yml", "desk.toml", "desk.png"}


def test_a_fault_of_the_package_says_where_and_traces_if_asked(monkeypatch, capsys):
    monkeypatch.setattr(cli, "disable_broken_opengl", None)
    with pytest.raises(TypeError):
        main(["info"])
    monkeypatch.delenv(cli.TRACE_VARIABLE)
    assert call("info") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("vergence: error: unexpected TypeError at cli.py:")
    assert "a fault of vergence itself" in line
