"""`vergence import ruler`: what a person measures becomes a head file."""

import builtins
import errno
import re
import sys

import pytest

from tests.commands.called import call, refused
from vergence.models import load_head


def test_measures_become_a_head_file(tmp_path):
    path = tmp_path / "desk.toml"
    assert call(
        "import", "ruler", "--baseline", "120", "--view", "60", "--servo", "XM430-W350",
        "--size", "1280x720", "--out", path, "--no-figure",
    ) == 0  # fmt: skip
    head = load_head(path)
    assert head.name == "desk"
    assert head.cameras.focal[0, 0] == pytest.approx(1108.5, abs=0.1)
    assert head.actuation.velocity[3] == pytest.approx(46 * 2 * 3.14159 / 60, abs=1e-3)
    assert "timing.latency_s" in head.assumptions


@pytest.mark.parametrize(
    ("words", "match"),
    [
        (["--baseline", "0.12"], r"baseline: expected 10 to 2000 mm \(is it in metres\?\), got"),
        (["--baseline", "120", "--view", "60"], "servo: expected it as --servo, got none"),
        (
            ["--baseline", "120", "--servo", "XL430", "--view", "60", "--focal", "500"],
            "expected one of --view, --diagonal and --focal",
        ),
        (["--servo", "XL99"], "servo: expected one of XL330-M288"),
        (["--view", "3"], "view: expected 5 to 150 degrees"),
    ],
)
def test_measures_in_other_units_or_missing_are_refused(tmp_path, capsys, words, match):
    path = tmp_path / "desk.toml"
    assert re.search(match, refused(capsys, "import", "ruler", *words, "--out", path))
    assert not path.exists()


def test_a_drawing_that_cannot_be_written_leaves_no_head_either(tmp_path, capsys, monkeypatch):
    def full(*_arguments):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("vergence.eval.head_figure.draw_head", full)
    words = ("--baseline", "120", "--view", "60", "--servo", "XL430", "--out", tmp_path / "a.toml")
    assert "No space left" in refused(capsys, "import", "ruler", *words)
    assert list(tmp_path.iterdir()) == []


def test_a_terminal_is_asked_and_asked_again(tmp_path, monkeypatch, capsys):
    answers = iter(["", "tilt", "0.12", "120", *[""] * 5, "78d", "XL99", "STS3215", "", ""])
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(builtins, "input", lambda _question: next(answers))
    path = tmp_path / "desk.toml"
    assert call("import", "ruler", "--out", path, "--no-figure") == 0
    head = load_head(path)
    assert head.joints[3] == "left_tilt"
    assert head.cameras.focal[0, 0] == pytest.approx(494.0, abs=0.1)
    told = capsys.readouterr().err
    assert "is it in metres?" in told
    assert "XL99" in told
