"""`vergence evaluate` as a person runs it."""

import json

import pytest

from tests.commands.called import run
from tests.heads import text_of
from tests.naming import named
from vergence.commands.evaluate import _print as show
from vergence.eval.comparison.evaluate import EvaluateConfig, evaluate
from vergence.eval.comparison.tables import report_tables


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_the_table_names_every_controller_and_what_it_ran_with(capsys, tmp_path):
    words = ("ibvs", "--episodes", "2", "--workers", "1", "--out", tmp_path / "run")
    code, out, _err = run(capsys, "evaluate", *words)
    assert code == 0
    assert "workspace on kinematic: 2 trials of 2 s" in out
    for word in ("ibvs", "gain 4", "ibvs-tuned", "bound", "x bound", "written to"):
        assert word in out
    assert json.loads((tmp_path / "run" / "evaluation.json").read_text())
    assert (tmp_path / "run" / "report.html").is_file()


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_the_table_names_the_head_and_what_it_cannot_do_away_with(capsys, tmp_path):
    (tmp_path / "mis.toml").write_text(text_of("mis"))
    words = ["ibvs", "--episodes", "2", "--workers", "1", "--head", tmp_path / "mis.toml"]
    code, out, _err = run(capsys, "evaluate", *words, "--legend", "--out", tmp_path / "run")
    assert code == 0
    assert "2 trials of 2 s, head mis" in out
    assert "Residual: the least error" in " ".join(out.split())
    rows = json.loads((tmp_path / "run" / "evaluation.json").read_text())
    assert {row["head"] for row in rows} == {"mis"}
    for row in rows[:-1]:
        assert 0.0 < row["residual_px"] <= row["residual_p95_px"] < 2.0
    assert "residual" in (tmp_path / "run" / "report.html").read_text()


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_json_alone_on_standard_output(capsys, tmp_path):
    code, out, _err = run(
        capsys, "evaluate", "ibvs", "--episodes", "2", "--workers", "1", "--json",
        "--scenario", "step", "--out", tmp_path / "run",
    )  # fmt: skip
    assert code == 0
    rows = json.loads(out)
    assert [row["controller"] for row in rows] == ["ibvs", "ibvs-tuned", "bound"]
    assert rows == json.loads((tmp_path / "run" / "evaluation.json").read_text())
    assert all(row["head"] == "simulated" and row["residual_px"] is None for row in rows)


@pytest.mark.slow
def test_a_mistake_is_one_line_and_leaves_nothing(capsys, tmp_path):
    for words in [
        ("ibsv",), ("ibvs", "--scenario", "moon"), ("ibvs", "--workers", "0"), ("none.vgp",),
        ("math:sqrt",), ("ibvs", "--scenario", "circle", "--plant", "rendered"),
    ]:  # fmt: skip
        code, out, err = run(capsys, "evaluate", *words, "--out", tmp_path / "run")
        assert code == 2, words
        assert out == ""
        lines = [line for line in err.splitlines() if line.startswith("vergence: ")]
        assert sum("error: " in line for line in lines) == 1
        assert not (tmp_path / "run").exists()


def test_an_unwritable_place_is_refused_before_any_trial(capsys, tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setattr("vergence.eval.comparison.evaluate.evaluate", None)
    code, _out, err = run(capsys, "evaluate", "ibvs", "--out", tmp_path / "file" / "run")
    assert code == 2
    assert "out: expected a folder that can be written" in err


@pytest.mark.slow
def test_no_number_of_the_table_is_cut_however_narrow_the_terminal_is(capsys, monkeypatch):
    evaluation = evaluate(EvaluateConfig(controllers=("ibvs",), scenarios=("robust",), episodes=4))
    (table,) = report_tables(evaluation)
    cells = [line for cell in table.rows[0][1:] for line in cell.splitlines()]
    for columns in (40, 80, 120):
        monkeypatch.setenv("COLUMNS", str(columns))
        show(evaluation, legend=False)
        out = capsys.readouterr().out
        with named(columns):
            assert "…" not in out
            assert all(cell in out for cell in cells)
            # a path is printed whole, to be copied
            assert max(map(len, out.partition("written to")[0].splitlines())) <= columns
