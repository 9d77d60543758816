"""The scripts that look for faults see the faults that they look for."""

import json

from tests.faults.fuzz import damage
from tests.faults.harness import Outcome
from tests.faults.interruptions import Reference, check
from tests.naming import named


def outcome(code=0, out="", err=""):
    return Outcome(words=("gaze",), code=code, seconds=1.0, out=out, err=err)


def test_a_command_that_ends_as_it_should_has_no_fault():
    assert outcome(2, err="vergence: error: head: expected a file, got x\n").faults() == []


def test_what_nobody_should_see_is_a_fault():
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


def test_a_folder_that_lacks_a_file_is_half_written(tmp_path):
    (tmp_path / "e").mkdir()
    (tmp_path / "e" / "evaluation.json").write_text("{}")
    files = frozenset(("evaluation.json", "report.html"))
    reference = Reference(seconds=1.0, changes=1, files=files, same=b"")
    assert check("evaluate", tmp_path, reference) == ["e lacks ['report.html']"]


def test_a_truncated_file_is_damaged(tmp_path):
    for name in ("a.json", "a.toml", "a.csv", "a.svg", "a.html", "a.png", "a.db"):
        with named(name):
            run = tmp_path / name.replace(".", "-")
            (run / "e").mkdir(parents=True)
            (run / "e" / name).write_bytes(b'a,b\n1,"2' if name == "a.csv" else b'{"half')
            (found,) = check("evaluate", run, None)
            assert found.startswith(f"{name} is damaged")


def test_an_experiment_marked_as_finished_has_its_table_and_figures(tmp_path):
    (tmp_path / "r" / "experiments").mkdir(parents=True)
    (tmp_path / "r" / "experiments" / "x.json").write_text(json.dumps({"figures": ["fig"]}))
    found = check("reproduce", tmp_path, None)
    assert found == ["x.json without x.csv", "x.json without fig.svg"]
