"""Quoted numbers: tables are made of run folders, and documents filled from tables."""

import re
from pathlib import Path

import pandas as pd
import pytest

from benchmarks.kept import Kept
from benchmarks.quoted import QuotedError, kept_of, main, quoted_keys, refill
from tests.naming import named

KEPT = Kept(("scenario", "controller"), "summary.csv", ("trials",))
KEYS = ["fast/pid/rms_px", "slow/pid/settle_s", "slow/saccade/settle_s"]


def run(folder: Path, **changes: object) -> tuple[str, Path]:
    """A run folder of two controllers in one scenario."""
    row = {"scenario": "slow", "head": "h", "trials": 10, "settle_s": 0.12345678, "rms_px": None}
    rows = [{**row, "controller": name, **changes} for name in ("pid", "saccade", "fuzzy")]
    folder.mkdir()
    pd.DataFrame(rows).to_csv(folder / "summary.csv", index=False)
    return "", folder


def test_of_run_folders_the_quoted_rows_and_columns_are_kept(tmp_path) -> None:
    one = run(tmp_path / "one")
    other = run(tmp_path / "two", scenario="fast", head="g", settle_s=None, rms_px=2.0)
    table = kept_of([one, other], KEPT, KEYS)
    assert list(table.columns) == ["scenario", "controller", "trials", "rms_px", "settle_s"]
    assert table.to_numpy().tolist() == [
        ["slow", "pid", "10", "", "0.123457"],
        ["slow", "saccade", "10", "", "0.123457"],
        ["fast", "pid", "10", "2", ""],
    ]


def test_rows_that_agree_are_one_and_rows_that_do_not_are_refused(tmp_path) -> None:
    one, same = run(tmp_path / "one"), run(tmp_path / "two", settle_s=0.12345681)
    assert len(kept_of([one, same], KEPT, KEYS)) == 2
    with pytest.raises(
        QuotedError, match=r"slow/pid/settle_s: expected one, got 0.123457 in .*one"
    ):
        kept_of([one, run(tmp_path / "other", settle_s=0.2)], KEPT, KEYS)


def test_a_document_is_filled_and_what_its_text_has_wrong_is_said(tmp_path) -> None:
    document = tmp_path / "a.md"
    document.write_text(
        "# Title\n\nIt takes 5 s, or 6 s.\n\n<!-- numbers t: 5 = a/s; 6 = b/s -->\n\n"
        "| | s |\n| - | - |\n| a | 7.00 |\n| b | - |\n| c | 1 |\n\n"
        "<!-- cells t\ncolumns: /*/s\nrows: a; b; c\n-->\n"
    )
    found = refill(document, {"t": lambda key: {"a/s": 5.2, "b/s": 8.0}[key.strip("/")]})
    assert "| a | 5.20 |\n| b | 8 |\n| c | 1 |\n" in document.read_text()
    assert [line.partition(".md")[2] for line in found] == [
        ":3: 6, but b/s is 8", ":11: 1, but there is no /c/s",
    ]  # fmt: skip
    assert quoted_keys("t", [document]) == ["a/s", "b/s", "c/s"]


def test_the_command_makes_a_table_of_what_the_readme_quotes(tmp_path, capsys) -> None:
    row = {"plant": "kinematic", "head": "simulated", "trials": 10, "settle_1px_median_s": 0.5}
    runs = [
        {**row, "scenario": scenario, "controller": name}
        for scenario in ("workspace", "nowhere")
        for name in ("pid", "nobody")
    ]
    folder, out = tmp_path / "run", tmp_path / "evaluate.csv"
    folder.mkdir()
    pd.DataFrame(runs).to_csv(folder / "summary.csv", index=False)
    assert main([str(folder), "--out", str(out)]) == 0
    assert pd.read_csv(out).to_dict("records") == [
        {"scenario": "workspace", "plant": "kinematic", "controller": "pid", "trials": 10,
         "settle_1px_median_s": 0.5}
    ]  # fmt: skip
    assert "no workspace/kinematic/saccade/settle_1px_median_s" in capsys.readouterr().err
    # a row that is measured again takes the place of the old one, the others stay
    pd.DataFrame([{**runs[0], "controller": "fuzzy"}]).to_csv(folder / "summary.csv", index=False)
    assert main([str(folder), "--out", str(out), "--keep"]) == 0
    assert list(pd.read_csv(out)["controller"]) == ["fuzzy", "pid"]


def test_what_cannot_be_is_said_in_one_line(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    for arguments, said in (
        (["nowhere", "--out", "evaluate.csv"], "nowhere: expected a run folder"),
        (["nowhere", "--out", "other.csv"], "--out: expected one of evaluate.csv, .*other.csv"),
        (["--fill", "nowhere.md"], "nowhere.md"),
    ):
        with named(arguments, said):
            assert main(arguments) == 2
            (line,) = capsys.readouterr().err.splitlines()
            assert re.search(said, line)
