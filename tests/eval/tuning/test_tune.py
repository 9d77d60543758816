"""Tuning: what is searched, that it goes on, and that many may share it."""

import json
import shutil
import sqlite3
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from optuna.exceptions import StorageInternalError
from optuna.samplers import RandomSampler
from sqlalchemy.exc import OperationalError

from tests.eval.mappers import Backwards
from tests.test_cli import call
from vergence.commands.tune import repeat_command
from vergence.controllers.controller import make_controller
from vergence.controllers.tuned import (
    TUNED_FILE,
    find_tuned_or_fallback,
    load_tuned,
    tuned_or_fallback_options,
)
from vergence.errors import ConfigurationError
from vergence.eval.trials.run import headline_metric, run_trials
from vergence.eval.trials.scenarios import load_scenario
from vergence.eval.tuning.objective import controller_objective
from vergence.eval.tuning.spaces import SEARCH_SPACES, SearchRange, TuneConfig
from vergence.eval.tuning.tune import SearchSpec, open_study, run_search, without_password
from vergence.models.head_file import load_head, save_head

BOWL = {"x": SearchRange(-2.0, 2.0), "y": SearchRange(0.01, 100.0, "log")}


def bowl(options):
    value = (options["x"] - 1.0) ** 2 + np.log(options["y"] / 3.0) ** 2
    return {"headline": float(value), "mean": 0.0}


def search(tmp_path, attempts=12, **changes):
    options = {
        "name": "bowl", "storage": str(tmp_path / "study.db"), "search_ranges": BOWL,
        "fixed_settings": {"episodes": 3}, "attempts": attempts, "seed": 0, "grid": False,
    }  # fmt: skip
    return SearchSpec(**{**options, **changes})


@pytest.mark.slow
def test_failures_are_not_given_up_for_a_shorter_median(tmp_path):
    def hasty(options):
        """The farther right the sooner, at the price of ever more failures from x = 0 on."""
        x = options["x"]
        settled = 1.0 - 0.2 * max(0.0, x)
        return {"headline": 1.0 - 0.1 * x, "mean": 0.0, "settled_fraction": settled}

    spans = {"x": SearchRange(-2.0, 2.0, "linear", 0.5)}
    whole = search(tmp_path, storage="sqlite://", search_ranges=spans, grid=True)
    attempts = run_search(whole, hasty)
    best = min(attempts, key=lambda attempt: attempt.rank)
    assert best.results["settled_fraction"] > 0.97
    assert min(attempts, key=lambda attempt: attempt.results["headline"]).rank > best.rank


def points(attempts):
    return [attempt.options for attempt in attempts]


@pytest.mark.slow
def test_a_stopped_search_tries_what_one_that_was_not_stopped_tries_the_first_point_once(tmp_path):
    first = {"x": 0.5, "y": 2.0}
    whole = points(run_search(search(tmp_path, 13, storage="sqlite://", first=first), bowl))
    assert len(run_search(search(tmp_path, 11, first=first), bowl)) == 11
    assert points(run_search(search(tmp_path, 13, first=first), bowl)) == whole
    assert whole[0] == first
    assert whole.count(first) == 1


@pytest.mark.slow
def test_points_that_cannot_be_are_passed_over(tmp_path):
    def picky(options):
        if options["x"] < 0.0:
            raise ConfigurationError("x: expected 0 or more")
        return bowl(options)

    attempts = run_search(search(tmp_path, 6, storage="sqlite://"), picky)
    assert 0 < len(attempts) < 6
    assert all(options["x"] >= 0.0 for options in points(attempts))


@pytest.mark.slow
def test_a_search_without_a_possible_point_says_why(tmp_path):
    def impossible(options):
        raise ConfigurationError("x: expected another")

    with pytest.raises(ConfigurationError, match="x: expected another"):
        run_search(search(tmp_path, 2, storage="sqlite://"), impossible)


@pytest.mark.slow
def test_a_study_does_not_go_on_with_another_setting(tmp_path):
    run_search(search(tmp_path, 1), bowl)
    for changes in (
        {"fixed_settings": {"episodes": 4}},
        {"seed": 1},
        {"search_ranges": {"x": SearchRange(0.0, 1.0)}},
    ):
        with pytest.raises(ConfigurationError, match="with which it was begun"):
            run_search(search(tmp_path, 1, **changes), bowl)


@pytest.mark.slow
def test_a_grid_has_every_point_once_across_calls(tmp_path):
    spans = {"x": SearchRange(0.5, 1.0, "linear", 0.1)}
    grid = search(tmp_path, search_ranges=spans, grid=True)
    tried = []

    def until(number):
        def judge(options):
            if len(tried) == number:
                raise KeyboardInterrupt
            tried.append(options["x"])
            return {"headline": options["x"], "mean": 0.0}

        return judge

    with pytest.raises(KeyboardInterrupt):
        run_search(grid, until(3))
    attempts = run_search(grid, until(None))
    assert sorted(tried) == pytest.approx(list(np.linspace(0.5, 1.0, 6)))
    assert sorted(o["x"] for o in points(attempts)) == sorted(tried)


def test_a_password_is_never_shown(tmp_path):
    pytest.importorskip("psycopg")
    url = "postgresql://me:secret@127.0.0.1:1/tuning"
    with pytest.raises(ConfigurationError, match=r"me:\*\*\*@127.0.0.1:1/tuning") as refused:
        run_search(search(tmp_path, storage=url), bowl)
    assert "secret" not in str(refused.value)
    assert without_password(str(tmp_path / "study.db")) == str(tmp_path / "study.db")


def test_a_storage_that_is_none_is_refused(tmp_path):
    file = tmp_path / "file"
    file.write_text("no database")
    for storage in (
        str(file), str(file / "study.db"), "postgresql://127.0.0.1:1/nothing?connect_timeout=1",
        "nonsense://x",
    ):  # fmt: skip
        with pytest.raises(ConfigurationError, match="storage: expected"):
            run_search(search(tmp_path, storage=storage), bowl)


WORKER = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from tests.eval.tuning.test_tune import bowl, search
from vergence.eval.tuning.tune import run_search
print("ready", flush=True)
sys.stdin.readline()
run_search(search(Path("."), 16, storage=sys.argv[2]), bowl)
"""


@pytest.fixture(scope="module")
def postgres(tmp_path_factory):
    pgserver = pytest.importorskip("pgserver", reason="pgserver is not installed")
    # a socket's path has at most 107 characters
    folder = tmp_path_factory.mktemp("pg")
    try:
        server = pgserver.get_server(folder, cleanup_mode="stop")
    except (OSError, subprocess.SubprocessError, AssertionError) as error:
        pytest.skip(f"PostgreSQL does not start here: {error}")
    yield server.get_uri()
    server.cleanup()


@pytest.mark.nightly
def test_several_processes_share_a_study_on_postgresql(postgres, tmp_path):
    root = str(Path(__file__).parents[3])
    workers = [
        subprocess.Popen(
            [sys.executable, "-c", WORKER, root, postgres], stdin=subprocess.PIPE,
            stdout=subprocess.PIPE, text=True,
        )
        for _ in range(2)
    ]  # fmt: skip
    for worker in workers:
        assert worker.stdout.readline() == "ready\n"
    for worker in workers:
        worker.stdin.write("go\n")
        worker.stdin.flush()
    for worker in workers:
        worker.communicate()
    assert [worker.returncode for worker in workers] == [0, 0]
    attempts = run_search(search(tmp_path, 16, storage=postgres), bowl)
    # whoever is in the middle of a point when the last one is done ends it
    assert 16 <= len(attempts) <= 17
    assert len({attempt.options["x"] for attempt in attempts}) == len(attempts)


def config(**changes):
    return TuneConfig(**{"controller": "ibvs", "episodes": 6, "grid": True, **changes})


def test_a_gain_is_judged_by_the_headline_metric_on_training_trials():
    scenario = load_scenario("workspace")
    head = scenario.model()
    found = controller_objective(config(seed=3), scenario, head)({"gain": 4.0})
    controller = make_controller("ibvs", head, gain=4.0)
    trials = run_trials(controller, scenario, episodes=6, split="train", seed=3)
    assert found["headline"] == headline_metric(trials)
    assert found["mean"] == trials.settle_or_trial_s().mean()


@pytest.mark.slow
def test_a_gain_is_judged_alike_by_whoever_runs_the_parts_of_its_trials(monkeypatch):
    monkeypatch.setattr("vergence.eval.tuning.objective._LEAST_JOB_TRIALS", 2)
    scenario = load_scenario("robust")
    found = [
        controller_objective(config(scenario="robust"), scenario, scenario.model(), mapper)(
            {"gain": 4.0}
        )
        for mapper in (None, Backwards())
    ]
    assert found[0] == found[1]


@pytest.mark.slow
def test_a_gain_is_judged_by_the_band_that_leads_and_with_the_gate_of_the_baseline():
    scenario = load_scenario("hardware")
    head = scenario.model()
    found = controller_objective(config(scenario="hardware"), scenario, head)({"gain": 3.0})
    controller = make_controller("ibvs-tuned", head, gain=3.0)
    trials = run_trials(controller, scenario, episodes=6, split="train", seed=0)
    assert found["headline"] == headline_metric(trials)
    assert found["mean"] == trials.settle_or_trial_s(2.0).mean()
    assert found["settled_fraction"] == 1.0
    # the article's law stops where its commands fall below the servos' steps
    plain = run_trials(
        make_controller("ibvs", head, gain=3.0), scenario, episodes=6, split="train", seed=0
    )
    assert np.isfinite(plain.settle_s(2.0)).mean() < 0.5


def test_a_gain_with_which_nothing_settles_counts_as_whole_trials():
    scenario = load_scenario("workspace")
    found = controller_objective(config(), scenario, scenario.model())({"gain": 0.05})
    assert found == {"headline": 2.0, "mean": 2.0, "settled_fraction": 0.0}


@pytest.fixture
def three_gains(monkeypatch):
    monkeypatch.setitem(SEARCH_SPACES, "ibvs", {"gain": SearchRange(3.0, 4.0, "linear", 0.5)})


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_the_command_writes_the_best_gain_the_history_and_the_curve(three_gains, tmp_path, capsys):
    folder = tmp_path / "run"
    words = ["tune", "ibvs", "--episodes", "6", "--workers", "1", "--out", str(folder)]
    assert call(*words) == 0
    printed = capsys.readouterr().out
    best = json.loads((folder / "tune.json").read_text())["best"]
    assert f"gain = {best['options']['gain']:g}" in printed
    history = pd.read_csv(folder / "history.csv")
    assert sorted(history["gain"]) == [3.0, 3.5, 4.0]
    assert best["headline"] == history["headline"].min()
    names = {path.name for path in folder.iterdir()}
    assert names == {
        *("config.toml", "head.toml", "history.csv", "study.db"),
        *("tune.json", "tune.png", "tune.svg"),
    }
    # again: nothing is left to do, and the files are written anew
    assert call(*words) == 0
    assert json.loads((folder / "tune.json").read_text())["best"] == best


def tuned_ibvs(tmp_path, *words):
    words = ["tune", "ibvs", "--episodes", "2", "--seed", "2", "--workers", "1", *words]
    return call(*words, "--out", str(tmp_path / "run"))


@pytest.fixture
def my_head(tmp_path):
    head = load_head("simulated").replace(name="mine", timing={"lag_s": 0.04})
    save_head(head, tmp_path / "my.toml")
    return head


@pytest.fixture
def package_table(tmp_path, monkeypatch):
    table = tmp_path / "package.toml"
    shutil.copy(TUNED_FILE, table)
    monkeypatch.setattr("vergence.controllers.tuned.TUNED_FILE", table)
    return table


@pytest.mark.nightly
@pytest.mark.usefixtures("undrawn")
def test_the_result_is_kept_in_the_users_table_for_its_head_and_never_in_the_package(
    three_gains, tmp_path, my_head, user_table, package_table, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    before = package_table.read_bytes()
    assert tuned_ibvs(tmp_path, "--head", "my.toml", "--plant", "mujoco", "--write") == 0
    assert f"written to {user_table}" in capsys.readouterr().out
    assert package_table.read_bytes() == before
    (entry,) = load_tuned(user_table).values()
    assert entry.key == ("ibvs", "workspace", my_head.digest)
    best = json.loads((tmp_path / "run" / "tune.json").read_text())["best"]
    assert entry.options == best["options"]
    assert (entry.head, entry.plant, entry.seed) == ("mine", "mujoco", 2)
    assert entry.command == (
        f"vergence tune ibvs --scenario workspace --head {tmp_path / 'my.toml'} --plant mujoco "
        "--episodes 2 --seed 2"
    )
    # the package's own head keeps its gain
    own = tuned_or_fallback_options("ibvs-tuned", "workspace", load_head("simulated"))
    assert own == {"gain": 4.1}


def test_the_recorded_command_names_all_that_changes_the_result():
    full = TuneConfig(controller="pid", head="physical", plant="mujoco", trials=7, seed=5)
    assert repeat_command(full, with_trials=True) == (
        "vergence tune pid --scenario workspace --head physical --plant mujoco --trials 7 "
        "--episodes 400 --seed 5"
    )
    grid = TuneConfig(controller="delay-compensated", grid=True)
    assert "--grid" in repeat_command(grid, with_trials=False)


@pytest.mark.nightly
@pytest.mark.usefixtures("undrawn")
def test_the_packages_table_is_for_maintainers_and_for_presets(
    three_gains, tmp_path, my_head, user_table, package_table, capsys
):
    before = load_tuned(package_table)
    head = str(tmp_path / "my.toml")
    assert tuned_ibvs(tmp_path, "--head", head, "--write-package") == 2
    assert (
        "write-package: expected the scenario's own head or a preset (icub, physical, simulated, "
        "turrets)" in capsys.readouterr().err
    )
    assert not (tmp_path / "run").exists()
    assert tuned_ibvs(tmp_path, "--write-package") == 0
    after = load_tuned(package_table)
    changed = {key for key in before if before[key] != after[key]}
    assert {key[:2] for key in changed} == {("ibvs", "workspace")}
    assert not user_table.exists()


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_options_are_found_for_the_head_of_the_scenario_with_its_own_parts(
    three_gains, tmp_path, user_table, package_table
):
    words = ["--scenario", "hardware", "--write", "--write-package"]
    assert tuned_ibvs(tmp_path, *words) == 0
    head = load_scenario("hardware").model()
    key = ("ibvs", "hardware", head.digest)
    (entry,) = load_tuned(user_table).values()
    assert entry.key == key
    assert entry.command == "vergence tune ibvs --scenario hardware --episodes 2 --seed 2"
    assert load_tuned(package_table)[key] == entry
    assert find_tuned_or_fallback("ibvs-tuned", "hardware", head) == entry


def test_a_damaged_table_is_refused_before_the_search_and_kept(tmp_path, user_table, capsys):
    user_table.parent.mkdir()
    user_table.write_text("[[tuned", encoding="utf-8")
    assert tuned_ibvs(tmp_path, "--write") == 2
    assert str(user_table) in capsys.readouterr().err
    assert user_table.read_text(encoding="utf-8") == "[[tuned"
    assert not (tmp_path / "run").exists()


@pytest.mark.nightly
def test_several_options_are_drawn_in_slices(tmp_path, capsys):
    folder = tmp_path / "run"
    words = ["tune", "adaptive", "--trials", "3", "--episodes", "2", "--out", str(folder)]
    words += ["--workers", "1"]
    assert call(*words) == 0
    assert len(pd.read_csv(folder / "history.csv")) == 3
    assert (folder / "tune.png").stat().st_size > 0


@pytest.mark.slow
def test_wrong_input_ends_in_one_clear_line_and_exit_code_2(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for words, said in [
        (["nonsense"], "'nonsense'"), (["ibvs", "--scenario", "nonsense"], "'nonsense'"),
        (["ibvs", "--episodes", "0"], "episodes"), (["adaptive", "--trials", "0"], "trials"),
        (["adaptive", "--grid"], "slope_zero"), (["policy", "--write"], "write"),
        (["policy", "--cluster", "127.0.0.1:6379"], "cluster"),
        (["ibvs", "--workers", "0"], "workers"),
    ]:  # fmt: skip
        assert call("tune", *words) == 2, words
        out, err = capsys.readouterr()
        assert out == ""
        assert len(err.strip().splitlines()) == 1
        assert said in err
        assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_study_that_can_no_longer_be_written_is_one_line_and_stays(tmp_path):
    place = str(tmp_path / "study.db")
    with open_study(place, "s", RandomSampler()) as study:
        study.tell(study.ask(), 1.0)
    full = OperationalError("INSERT", {}, Exception("database or disk is full"))
    with (
        pytest.raises(ConfigurationError, match=r"study\.db can no longer .*disk is full") as said,
        open_study(place, "s", RandomSampler()),
    ):
        raise StorageInternalError("An exception is raised during the commit.") from full
    assert "\n" not in str(said.value)
    assert sqlite3.connect(place).execute("SELECT count(*) FROM trials").fetchone() == (1,)
