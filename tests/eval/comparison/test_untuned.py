"""A head that nothing was tuned for: it is said, tuned for when asked, or given options."""

import json
import sys
import tomllib

import pandas as pd
import pytest

from tests.eval.mappers import Backwards
from vergence.cli import main
from vergence.controllers.tuned import TunedEntry, find_tuned_or_fallback, load_tuned, write_tuned
from vergence.errors import ConfigurationError
from vergence.eval.comparison.contestants import resolve_options
from vergence.eval.comparison.evaluate import BASELINE, EvaluateConfig, evaluate
from vergence.eval.comparison.folder import write_evaluation
from vergence.eval.comparison.tables import (
    RESIDUAL_COLUMN,
    describe_evaluation,
    report_tables,
    table_legend,
)
from vergence.eval.trials.scenarios import load_scenario
from vergence.eval.tuning import objective
from vergence.eval.tuning.spaces import SEARCH_SPACES, SearchRange
from vergence.models.head_file import load_head, save_head
from vergence.reporting.jobs import SerialMapper

MARK = "untuned for this head"


@pytest.fixture
def mine(tmp_path):
    head = load_head("simulated").replace(name="mine", timing={"lag_s": 0.045})
    save_head(head, tmp_path / "my.toml")
    return str(tmp_path / "my.toml")


@pytest.fixture
def few_gains(monkeypatch):
    monkeypatch.setitem(SEARCH_SPACES, "ibvs", {"gain": SearchRange(3.0, 5.0, "linear", 0.4)})
    monkeypatch.setattr(objective, "EPISODES", 6)


def rows_of(evaluation) -> dict[str, dict]:
    return {row["controller"]: row for row in evaluation.rows()}


@pytest.mark.slow
def test_a_network_of_another_head_is_left_out_unless_nothing_else_was_asked(mine):
    config = EvaluateConfig(controllers=("learned-policy", "ibvs"), episodes=2, head=mine)
    evaluation = evaluate(config)
    assert set(rows_of(evaluation)) == {"ibvs", BASELINE, "bound"}
    assert any(note.startswith("learned-policy is left out") for note in evaluation.notes)
    with pytest.raises(ConfigurationError, match="trained for head"):
        evaluate(EvaluateConfig(controllers=("learned-policy",), episodes=2, head=mine))


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_baseline_of_another_head_is_marked_in_rows_tables_text_and_files(mine, tmp_path):
    config = EvaluateConfig(controllers=("ibvs", "pid"), episodes=2, head=mine)
    evaluation = evaluate(config)
    rows = rows_of(evaluation)
    for name in (BASELINE, "pid"):
        assert (rows[name]["tuned"], rows[name]["tuned_for"]) == (False, "simulated")
    assert rows["ibvs"]["tuned"] is None  # it stands for the article, and is not tuned
    assert rows["bound"]["tuned"] is None
    (table,) = report_tables(evaluation)
    assert "x faster than untuned" in table.columns
    labels = {row[0].split("\n")[0]: row[0] for row in table.rows}
    assert MARK in labels[BASELINE]
    assert MARK in labels["pid"]
    assert MARK not in labels["ibvs"]
    assert f"{BASELINE}, {MARK}, takes" in " ".join(describe_evaluation(evaluation).found.split())
    assert "Untuned for this head" in table_legend(evaluation)
    assert any(note.startswith("pid, ibvs-tuned: untuned") for note in evaluation.notes)
    write_evaluation(tmp_path, evaluation)
    assert MARK in (tmp_path / "report.html").read_text()
    summary = pd.read_csv(tmp_path / "summary.csv").set_index("controller")
    assert not summary.loc[BASELINE, "tuned"]
    assert not summary.loc["ibvs", "baseline_tuned"]
    config = tomllib.loads((tmp_path / "config.toml").read_text())
    assert config["tuned"] == {BASELINE: {"workspace": False}, "pid": {"workspace": False}}


@pytest.mark.slow
def test_nothing_is_marked_for_a_scenarios_own_head():
    evaluation = evaluate(EvaluateConfig(controllers=("pid",), episodes=2))
    assert {row["tuned"] for row in evaluation.rows()} == {True, None}
    (table,) = report_tables(evaluation)
    assert MARK not in str(table) + describe_evaluation(evaluation).found + table_legend(evaluation)
    assert evaluation.notes == []


@pytest.mark.slow
def test_defaults_that_nothing_was_tuned_for_are_marked_too():
    rows = rows_of(evaluate(EvaluateConfig(controllers=("pid",), scenarios=("line",), episodes=1)))
    assert (rows["pid"]["tuned"], rows["pid"]["tuned_for"]) == (False, None)


def test_options_of_the_heads_digest_run_and_are_not_marked(mine, user_table):
    head = load_head(mine)
    write_tuned(
        user_table,
        TunedEntry(
            controller="ibvs", scenario="workspace", head="other name", digest=head.digest,
            command="c", seed=0, options={"gain": 3.65},
        ),
    )  # fmt: skip
    # a worker has no table of the user's: what it runs with is found here
    evaluation = evaluate(EvaluateConfig(episodes=2, head=mine, controllers=("ibvs",)))
    row = rows_of(evaluation)[BASELINE]
    assert (row["tuned"], row["options"]) == (True, {"gain": 3.65})
    assert "x faster than ibvs-tuned" in report_tables(evaluation)[0].columns


@pytest.mark.slow
def test_tune_tunes_the_baseline_first_and_keeps_what_it_found(few_gains, mine, user_table):
    config = EvaluateConfig(controllers=("ibvs",), episodes=2, head=mine, tune=True)
    told = []
    evaluation = evaluate(config, mapper=SerialMapper(lambda done, of: told.append((done, of))))
    row = rows_of(evaluation)[BASELINE]
    assert row["tuned"] is True
    (entry,) = load_tuned(user_table).values()
    assert entry.options == row["options"]
    assert entry.digest == load_head(mine).digest
    assert (
        entry.command == f"vergence evaluate ibvs-tuned --scenario workspace --head {mine} --tune"
    )
    assert len(told) > 6  # progress over the gains, too
    before = user_table.read_bytes()
    told.clear()
    again = evaluate(config, mapper=SerialMapper(lambda done, of: told.append((done, of))))
    assert rows_of(again)[BASELINE]["options"] == row["options"]
    assert told == [(1, 2), (2, 2)]
    assert user_table.read_bytes() == before


@pytest.mark.nightly
def test_the_search_finds_the_best_gain_of_the_grid_whoever_runs_the_jobs(few_gains):
    scenario = load_scenario("workspace")
    head = scenario.model()
    every = objective._try(SEARCH_SPACES["ibvs"]["gain"].points(), scenario, head, SerialMapper())
    best = min(every, key=lambda one: one.rank).options["gain"]
    assert objective.best_gain(scenario, head, SerialMapper()) == best
    assert objective.best_gain(scenario, head, Backwards()) == best


@pytest.mark.slow
def test_a_best_gain_at_the_edge_of_the_search_is_refused(few_gains, monkeypatch):
    monkeypatch.setitem(SEARCH_SPACES, "ibvs", {"gain": SearchRange(2.0, 3.0, "linear", 0.25)})
    scenario = load_scenario("workspace")
    with pytest.raises(ConfigurationError, match="a best gain below 3, the greatest that is tried"):
        objective.best_gain(scenario, scenario.model(), SerialMapper())


@pytest.mark.slow
def test_a_head_with_which_nothing_settles_has_no_best_gain(few_gains):
    head = load_head("simulated").replace(timing={"latency_s": 1.5, "lag_s": 0.2})
    with pytest.raises(ConfigurationError, match="expected trials of workspace that settle"):
        objective.best_gain(load_scenario("workspace"), head, SerialMapper())


def test_a_table_that_cannot_be_written_is_refused_before_the_search(
    few_gains, mine, monkeypatch, tmp_path
):
    (tmp_path / "file").touch()
    monkeypatch.setenv("VERGENCE_TUNED", str(tmp_path / "file" / "tuned.toml"))
    monkeypatch.setattr(objective, "best_gain", lambda *_: pytest.fail("searched all the same"))
    with pytest.raises(ConfigurationError, match="expected a"):
        objective.tune_baseline(load_scenario("workspace"), load_head(mine), mine, SerialMapper())


def test_what_iterations_leave_is_no_residual_in_the_table():
    evaluation = evaluate(EvaluateConfig(controllers=("ibvs",), scenarios=("step",), episodes=2))
    trials = [outcome.trials for outcome in evaluation.outcomes]
    for table in trials:
        table["residual_px"] = 2e-6
    assert RESIDUAL_COLUMN not in report_tables(evaluation)[0].columns
    for table in trials:
        table["residual_px"] = 0.02
    assert RESIDUAL_COLUMN in report_tables(evaluation)[0].columns


def test_a_baseline_whose_options_were_given_is_marked():
    config = EvaluateConfig(controllers=("pid",), episodes=2)
    evaluation = evaluate(config, options={BASELINE: {"gain": 0.7}})
    (table,) = report_tables(evaluation)
    assert "x faster than given" in table.columns
    assert rows_of(evaluation)[BASELINE]["given"] == ["gain"]


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_the_command_says_what_it_tunes_where_it_is_kept_and_needs_no_optuna(
    few_gains, mine, tmp_path, user_table, monkeypatch, capsys
):
    monkeypatch.setitem(sys.modules, "optuna", None)
    words = ["evaluate", "ibvs", "--head", mine, "--tune", "--episodes", "2", "--workers", "1"]
    with pytest.raises(SystemExit) as stop:
        main([*words, "--out", str(tmp_path / "run")])
    assert not stop.value.code
    out, err = capsys.readouterr()
    assert "tuning ibvs-tuned for the head mine in workspace" in err
    assert f"kept in {user_table}" in err
    assert MARK not in out


OPTIONS = """
[ibvs]
gain = 2.0
[ibvs.step]
gain = 2.5
[ibvs-tuned]
gain = 3.6
[state-feedback]
delay = "nominal"
[pursuit]
braking = 0.8
"""


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_file_gives_options_by_controller_and_by_scenario(tmp_path, mine):
    (tmp_path / "options.toml").write_text(OPTIONS, encoding="utf-8")
    config = EvaluateConfig(
        controllers=("ibvs", "state-feedback", "pursuit"), scenarios=("workspace", "step"),
        episodes=2, options=tmp_path / "options.toml",
    )  # fmt: skip
    evaluation = evaluate(config)
    found = {(row["scenario"], row["controller"]): row for row in evaluation.rows()}
    assert found["workspace", "ibvs"]["options"] == {"gain": 2.0}
    assert found["step", "ibvs"]["options"] == {"gain": 2.5}
    assert found["step", BASELINE]["options"] == {"gain": 3.6}
    assert found["step", BASELINE]["tuned"] is None
    feedback = found["workspace", "state-feedback"]
    own = find_tuned_or_fallback("state-feedback", "workspace", load_head("simulated"))
    assert feedback["options"] == {**own.options, "delay": "nominal"}  # over the tuned ones
    assert feedback["tuned"] is True
    pursuit = found["workspace", "pursuit"]
    assert (pursuit["options"], pursuit["tuned"]) == ({"braking": 0.8}, None)
    assert "given by --options" in str(report_tables(evaluation)[0])
    (tmp_path / "run").mkdir()
    write_evaluation(tmp_path / "run", evaluation)
    kept = tomllib.loads((tmp_path / "run" / "config.toml").read_text())
    assert kept["controllers"]["ibvs"] == {"workspace": {"gain": 2.0}, "step": {"gain": 2.5}}
    assert kept["config"]["options"] == str(tmp_path / "options.toml")
    assert json.loads((tmp_path / "run" / "evaluation.json").read_text()) == evaluation.rows()


def test_options_of_an_entry_point_go_to_its_class():
    word = "vergence.controllers.ibvs:IBVS"
    evaluation = evaluate(
        EvaluateConfig(controllers=(word,), episodes=2), options={word: {"gain": 1.5}}
    )
    assert rows_of(evaluation)[word]["options"] == {"gain": 1.5}
    slow, fast = (rows_of(evaluation)[name]["settle_1px_median_s"] for name in (word, BASELINE))
    assert slow > fast


def test_a_mistake_in_the_options_names_file_and_key_in_one_line(tmp_path):
    path = tmp_path / "options.toml"
    for content, said in [
        ("[pdi]\nkp = 1.0", r"pdi: expected a controller of ibvs, .*"),
        ("pid = 3", r"pid: expected a table"),
        ("[ibvs]\ngian = 1.0", r"ibvs\.gian: expected one of its options, depth, gain, .*"),
        ("[ibvs.wrkspace]\ngain = 1.0", r"ibvs\.wrkspace: expected an option's value, or a scen.*"),
        ("[ibvs]\ngain = -1.0", r"ibvs\.gain: gain: expected finite gains >= 0, got -1\.0"),
        ("[ibvs]\nspeed_limit = 1.0\ngain = 'x'", r"ibvs\.gain: gain: expected a number.*"),
        ("[pid]\nkp = 1.0\nfilter_s = 'x'", r"pid\.filter_s: .*"),
        ("[ibvs", r"expected a TOML file.*"),
    ]:
        path.write_text(content, encoding="utf-8")
        config = EvaluateConfig(controllers=("ibvs", "pid"), episodes=2, options=path)
        with pytest.raises(ConfigurationError, match=said) as caught:
            evaluate(config)
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)


def test_options_of_a_controller_that_does_not_take_part_are_noted(tmp_path):
    evaluation = evaluate(
        EvaluateConfig(controllers=("ibvs",), episodes=1), options={"pid": {"kp": 3.0}}
    )
    assert evaluation.notes == ["options of pid in options are not used: it does not take part"]


@pytest.mark.slow
def test_a_law_with_one_set_of_options_is_never_untuned(mine):
    names = ("saccade", "pursuit")
    rows = rows_of(evaluate(EvaluateConfig(controllers=names, episodes=1, head=mine)))
    for name in names:
        row = rows[name]
        assert (row["tuned"], row["tuned_for"], row["options"]) == (None, None, {})


def test_another_heads_options_are_values_to_begin_with(mine):
    head = load_head(mine)
    entry = find_tuned_or_fallback("state-feedback", "workspace", head)
    found = resolve_options("state-feedback", head, "workspace", {})
    assert (found.options, found.tuned, found.tuned_for) == (entry.options, False, "simulated")
