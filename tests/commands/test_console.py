"""Notes of commands fit into one line and into the terminal's encoding."""

import io
import sys

import pytest

from tests.commands.called import call
from vergence.commands.console import print_to_stderr, replace_unprintable


class Terminal:
    """Standard output and error in an encoding that lacks much; they raise for what it lacks."""

    def __init__(self, encoding: str) -> None:
        self._streams = [io.TextIOWrapper(io.BytesIO(), encoding=encoding) for _ in range(2)]
        self._encoding = encoding

    def __enter__(self) -> "Terminal":
        self._before = sys.stdout, sys.stderr
        sys.stdout, sys.stderr = self._streams
        return self

    def __exit__(self, *exception: object) -> None:
        sys.stdout, sys.stderr = self._before
        for stream in self._streams:
            stream.flush()
        written = [stream.buffer.getvalue() for stream in self._streams]
        self.out, self.err = (data.decode(self._encoding) for data in written)


def test_ranges_signs_and_boxes_are_written_with_what_looks_alike():
    for encoding, dash in (("ascii", "-"), ("cp1252", "–"), ("latin-1", "-")):
        with Terminal(encoding) as terminal:
            replace_unprintable()
            print("651–700 −3 ─│┼ 漢")
        assert terminal.out == f"651{dash}700 -3 -|+ \\u6f22\n"


@pytest.mark.usefixtures("undrawn")
def test_every_table_is_printed_in_ascii_too(tmp_path):
    with Terminal("ascii") as terminal:
        assert call("gaze", "--plant", "kinematic", "--out", tmp_path / "ä漢") == 0
    assert "truth" in terminal.out
    assert "written to" in terminal.out
    assert terminal.err == ""


def test_a_name_that_the_terminal_cannot_show_is_still_one_line():
    with Terminal("ascii") as terminal:
        assert call("gaze", "--head", "κεφάλι.toml") == 2
    (line,) = terminal.err.splitlines()
    assert line.startswith("vergence: error: ")
    assert ".toml: No such file or directory; expected a TOML file" in line


def test_a_note_is_one_printable_line_of_bounded_length(capsys):
    print_to_stderr("a\nb\r\nc\x1b[31m\0" + "x" * 100_000)
    err = capsys.readouterr().err
    assert err.startswith("vergence: a b c\\x1b[31m\\x00xxx")
    assert len(err.splitlines()) == 1
    assert len(err) < 1100
