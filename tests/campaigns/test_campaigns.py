"""The campaigns see the faults that they look for, and still run."""

import json

import pytest

pytest.importorskip("mcap")

from tests.campaigns.commands import damage
from tests.campaigns.harness import Outcome, try_each
from tests.campaigns.interruptions import Reference, check
from tests.campaigns.robot import FaultError, Inputs, watched
from tests.naming import named
from vergence.errors import ConfigurationError


def outcome(code=0, out="", err=""):
    return Outcome(code, 1.0, out, err)


def test_what_nobody_should_see_of_a_command_is_a_fault():
    assert outcome(2, err="vergence: error: head: expected a file, got x\n").faults() == []
    for ended, fault in (
        (outcome(1, err="Traceback (most recent call last):\n"), "a stack trace"),
        (outcome(0, out='  File "x.py", line 3, in f\n'), "a stack trace"),
        (outcome(70), "exit code 70"),
        (outcome(2, err="x (a fault of vergence itself: ..."), "an unexpected error"),
        (outcome(2), "exit code 2 and not a word"),
    ):
        with named(ended, fault):
            assert fault in ended.faults()


def test_each_damage_changes_the_file(tmp_path):
    content = b'key = "value"\nnumber = 3.5\n'
    for kind in ("token", "flip", "cut", "end", "insert", "gone", "folder", "empty"):
        path = tmp_path / kind
        path.write_bytes(content)
        damage(path, ((kind, 500_000, b"nan"),))
        assert not path.is_file() or path.read_bytes() != content, kind


def test_what_is_half_written_is_a_fault(tmp_path):
    (tmp_path / "e").mkdir()
    (tmp_path / "e" / "evaluation.json").write_text("{}")
    files = frozenset(("evaluation.json", "report.html"))
    reference = Reference(seconds=1.0, changes=1, files=files, same=b"")
    assert check("evaluate", tmp_path, reference) == ["e lacks ['report.html']"]
    for name in ("a.json", "a.toml", "a.csv", "a.svg", "a.html", "a.png", "a.db"):
        with named(name):
            run = tmp_path / f".{name}"
            (run / "e").mkdir(parents=True)
            (run / "e" / name).write_bytes(b'a,b\n1,"2' if name == "a.csv" else b'{"half')
            (found,) = check("evaluate", run, None)
            assert found.startswith(f"{name} is damaged")
    (tmp_path / "e" / "experiments").mkdir()
    (tmp_path / "e" / "experiments" / "x.json").write_text(json.dumps({"figures": ["fig"]}))
    found = check("reproduce", tmp_path, None)
    assert found == ["x.json without x.csv", "x.json without fig.svg"]


def test_what_nobody_should_see_of_an_input_is_a_fault(tmp_path):
    def raises(error):
        with watched(tmp_path):
            raise error

    for error in (ValueError("x"), *map(ConfigurationError, ("a\nb", "\x1b[31m", "", 5000 * "a"))):
        with pytest.raises(FaultError):
            raises(error)
    raises(ConfigurationError("one line"))


def test_the_configuration_that_is_damaged_is_whole(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    inputs = Inputs(tmp_path)
    inputs.config(((), ()))
    assert inputs.found.ends == {"answer": 1}


@pytest.mark.nightly
def test_whatever_a_robot_is_given_is_an_answer_or_one_error_of_ours(tmp_path):
    inputs = Inputs(tmp_path)
    for name, count in (("config", 60), ("log", 60), ("line", 60), ("stream", 1)):
        cases, attempt = inputs.attempts()[name]
        before = inputs.found.ends.total()
        try_each(cases, attempt, 20261125, count)
        assert inputs.found.ends.total() > before, name
