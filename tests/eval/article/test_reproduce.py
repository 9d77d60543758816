"""Experiments run into a folder, are kept, and are reported on."""

import errno
import json
import re
import shutil
import tomllib
from collections.abc import Iterator
from dataclasses import replace

import pandas as pd
import pytest
import tomli_w

from tests.conftest import sketched
from tests.eval.conftest import toy_alone
from tests.eval.mappers import Backwards
from tests.eval.refusals import not_refused
from tests.naming import named
from vergence.errors import ConfigurationError, UnknownNameError
from vergence.eval.article.config import ReproduceConfig
from vergence.eval.article.criterion import count_verdicts
from vergence.eval.article.experiment import read_overrides
from vergence.eval.article.reported import reported_results
from vergence.eval.article.reproduce import reproduce, write_folder_report
from vergence.files import hold_lock
from vergence.reporting.report import ReportSection
from vergence.reporting.runs import write_parquet
from vergence.reporting.text import format_number

pytestmark = pytest.mark.usefixtures("toy", "undrawn")


def config(folder, **changes) -> ReproduceConfig:
    words = tuple(settings(changes.pop("overrides", {})))
    return ReproduceConfig(out=folder / "run", set=words, **changes)


def settings(values, place="") -> Iterator[str]:
    """`FIELD=VALUE` for each value, where a field of a field has both names."""
    for name, value in values.items():
        if isinstance(value, dict):
            yield from settings(value, f"{place}{name}.")
        else:
            yield place + tomli_w.dumps({name: value}).strip()


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("finished")
    with pytest.MonkeyPatch.context() as patch, sketched():
        toy_alone(patch)
        reproduce(config(folder))
    return folder / "run"


@pytest.fixture
def run(finished, tmp_path):
    return shutil.copytree(finished, tmp_path / "run")


def test_a_run_writes_tables_figures_summary_config_and_report(finished):
    names = {str(path.relative_to(finished)) for path in finished.rglob("*.*")}
    assert names == {
        "tables/toy.csv", "figures/toy-values.svg", "figures/toy-values.png",
        "experiments/toy.json", "summary.json", "numbers.json", "config.toml", "report.html",
    }  # fmt: skip


@pytest.mark.slow
def test_a_table_that_is_made_anew_leaves_no_parquet_of_the_former_one(tmp_path, run):
    former = write_parquet(run / "tables" / "toy.csv")
    reproduce(config(tmp_path))
    assert former.exists()
    reproduce(config(tmp_path, seed=7))
    assert not former.exists()


def test_the_resolved_config_and_seed_are_saved(tmp_path):
    reproduce(config(tmp_path, seed=7, overrides={"toy": {"scale": 3.0}}))
    content = tomllib.loads((tmp_path / "run" / "config.toml").read_text())
    assert content["experiments"]["toy"]["scale"] == 3.0
    assert content["experiments"]["toy"]["draws"] == 5
    assert content["experiments"]["toy"]["seed"] == 7
    assert "numpy" in content["versions"]


def test_the_report_has_the_ratio_of_our_figure_to_the_articles(finished):
    (row,) = json.loads((finished / "summary.json").read_text())
    assert set(row) == {
        "experiment", "quantity", "method", "axis", "unit", "article_low", "article_high",
        "ours_low", "ours_high", "verdict",
    }  # fmt: skip
    ratio = format_number(row["ours_low"] / row["article_low"])
    assert f'data-label="ratio">{ratio}</td>' in (finished / "report.html").read_text()


def test_the_numbers_of_the_text_are_saved_by_experiment(finished):
    numbers = json.loads((finished / "numbers.json").read_text())
    mean = pd.read_csv(finished / "tables" / "toy.csv")["value_mm"].mean()
    assert numbers == {"toy": {"count": 5, "mean_mm": pytest.approx(mean)}}


@pytest.mark.slow
def test_an_interrupted_run_keeps_what_is_finished_and_goes_on(tmp_path, monkeypatch):
    options = config(tmp_path)

    def interrupt(*_args: object, **_options: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(pd.DataFrame, "to_csv", interrupt)
        with pytest.raises(KeyboardInterrupt):
            reproduce(options)
    assert not list((tmp_path / "run" / "tables").iterdir())
    assert not list((tmp_path / "run" / "experiments").iterdir())
    reproduce(options)
    assert (tmp_path / "run" / "experiments" / "toy.json").exists()


@pytest.mark.slow
def test_what_a_kill_has_left_half_written_is_removed(tmp_path):
    for part in ("", "tables"):
        (tmp_path / "run" / part / ".vergence-partial-1").mkdir(parents=True)
    reproduce(config(tmp_path))
    assert not list((tmp_path / "run").rglob(".*"))


def test_what_another_process_is_writing_is_left_alone(tmp_path):
    theirs = tmp_path / "run" / "tables" / ".vergence-partial-1"
    theirs.mkdir(parents=True)
    with hold_lock(tmp_path / "run"), pytest.raises(ConfigurationError, match="is writing"):
        reproduce(config(tmp_path))
    assert theirs.exists()


class Warned:
    """A listener that keeps what it is warned of, and which experiments ran."""

    def __init__(self) -> None:
        self.said: list[str] = []
        self.ran: list[str] = []

    def begin(self, _name):
        return lambda _done, _total: None

    def warn(self, name, why):
        self.said.append(f"{name} {why}")

    def end(self, name, seconds):
        if seconds is not None:
            self.ran.append(name)


@pytest.mark.slow
def test_an_experiment_with_a_missing_or_damaged_file_runs_again_and_says_so(tmp_path, run):
    whole = {path: path.read_bytes() for path in run.rglob("*.*")}
    for file, damage in [
        ("experiments/toy.json", lambda content: content[:-20]),
        ("experiments/toy.json", lambda content: content.replace(b'"rows": 5', b'"rows": "many"')),
        ("tables/toy.csv", None),
        ("tables/toy.csv", lambda content: content[:-20]),
        ("figures/toy-values.svg", lambda content: content[:-20]),
        ("figures/toy-values.png", lambda content: content[:-20]),
    ]:
        with named(file):
            (run / file).unlink()
            if damage is not None:
                (run / file).write_bytes(damage(whole[run / file]))
            listener = Warned()
            reproduce(config(tmp_path), listener)
            assert listener.ran == ["toy"]
            assert (run / file).read_bytes() == whole[run / file]
            (said,) = listener.said
            assert said.startswith(f"toy runs anew: {file}")


def test_a_record_of_an_experiment_that_is_none_is_said(run):
    for content in ("[1, 2]", "[" * 10_000):
        (run / "experiments/toy.json").write_text(content)
        listener = Warned()
        assert write_folder_report(run, listener.warn) == []
        (said,) = listener.said
        assert said.startswith("toy experiments/toy.json")


def test_a_folder_in_the_place_of_a_figure_is_left_alone(tmp_path, run):
    (run / "figures/toy-values.png").unlink()
    (run / "figures/toy-values.png").mkdir()
    with pytest.raises(ConfigurationError, match="toy cannot be written"):
        reproduce(config(tmp_path), Warned())
    assert (run / "figures/toy-values.png").is_dir()


def test_a_damaged_experiment_that_is_not_asked_for_is_left_out_of_the_report(run):
    (run / "tables" / "toy.csv").unlink()
    listener = Warned()
    sections = write_folder_report(run, listener.warn)
    assert sections == []
    assert listener.said == ["toy tables/toy.csv is missing"]
    assert json.loads((run / "numbers.json").read_text()) == {}
    assert "A toy" not in (run / "report.html").read_text()


@pytest.mark.slow
def test_an_experiment_that_replaces_a_finished_one_says_why(tmp_path, run):
    for change, said in [
        ({"seed": 1}, "another seed"),
        ({"quick": True, "seed": 1}, "another config"),
        ({"quick": True, "seed": 1, "overrides": {"toy": {"scale": 3.0}}}, "another config"),
    ]:
        listener = Warned()
        reproduce(config(tmp_path, **change), listener)
        assert listener.ran == ["toy"]
        assert [said in line for line in listener.said] == [True]


@pytest.mark.slow
def test_what_a_new_run_replaces_stays_until_it_is_finished(tmp_path, run, monkeypatch):
    files = {path: path.read_bytes() for path in run.rglob("*.*")}

    def fail(*_args: object, **_options: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(pd.DataFrame, "to_csv", fail)
        with pytest.raises(ConfigurationError, match=r"toy cannot be written to .*No space left"):
            reproduce(config(tmp_path, seed=1))
    assert {path: path.read_bytes() for path in run.rglob("*.*")} == files
    listener = Warned()
    reproduce(config(tmp_path), listener)
    assert listener.ran == []


@pytest.mark.slow
def test_a_report_that_cannot_be_written_is_one_line_and_the_results_stay(tmp_path, monkeypatch):
    def fail(*_args: object, **_options: object) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    with monkeypatch.context() as patch:
        patch.setattr("vergence.eval.article.reproduce.write_report", fail)
        with pytest.raises(ConfigurationError, match="the report cannot be written"):
            reproduce(config(tmp_path))
    listener = Warned()
    reproduce(config(tmp_path), listener)
    assert (listener.ran, listener.said) == ([], [])


def test_what_another_version_kept_is_as_if_it_were_not_there(tmp_path):
    marker = tmp_path / "run" / "experiments" / "toy.json"
    marker.parent.mkdir(parents=True)
    marker.write_text(json.dumps({"identity": {}, "conclusion": "of old"}))
    reproduce(config(tmp_path))
    assert "conclusion" not in json.loads(marker.read_text())


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes_whoever_runs_the_jobs(tmp_path, undrawn):
    undrawn.undo()
    for folder, mapper in (("one", None), ("other", Backwards())):
        reproduce(config(tmp_path / folder), mapper=mapper)
    for name in ("tables/toy.csv", "figures/toy-values.svg", "figures/toy-values.png"):
        one, other = (tmp_path / folder / "run" / name for folder in ("one", "other"))
        assert one.read_bytes() == other.read_bytes()
        assert one.stat().st_size > 80


def test_the_report_is_self_contained_and_its_ids_are_unique(finished):
    text = (finished / "report.html").read_text()
    assert not re.findall(r'(?:src|href)="(?:https?|file):', text)
    ids = re.findall(r'\sid="([^"]+)"', text)
    assert len(ids) == len(set(ids)) > 0
    assert "A toy &lt;experiment&gt;" in text
    assert "The mean of 5 values is" in text
    assert "<svg" in text


def report_text(folder) -> str:
    page = (folder / "run" / "report.html").read_text(encoding="utf-8")
    page = re.sub(r"<(style|svg)\b.*?</\1>", " ", page, flags=re.DOTALL)
    return " ".join(re.sub(r"<[^>]+>", "", page).split())


@pytest.mark.slow
def test_a_quick_report_says_first_that_it_is_quick_as_long_as_a_part_of_it_is(tmp_path):
    reproduce(config(tmp_path, quick=True))
    first, said = report_text(tmp_path)[:900], report_text(tmp_path)
    assert "This is a quick run." in first
    assert "verdicts can differ" in first
    assert "toy: draws 2" in first
    assert "The mean of 2 values" in said
    assert "The mean of 5 values" not in said
    again = reproduce(config(tmp_path, quick=True))
    assert again[0].quick
    assert "This is a quick run." in report_text(tmp_path)
    reproduce(config(tmp_path))
    assert "This is a quick run." not in report_text(tmp_path)


@pytest.mark.slow
def test_a_changed_configuration_is_said_first_too(tmp_path):
    reproduce(config(tmp_path, overrides={"toy": {"scale": 3.0}}))
    assert "Changed configuration" in report_text(tmp_path)[:600]
    assert "toy: scale 3.0" in report_text(tmp_path)
    reproduce(config(tmp_path))
    assert "Changed configuration" not in report_text(tmp_path)


def test_the_report_begins_with_what_was_found_and_what_reproduced_requires(tmp_path, monkeypatch):
    (row,) = reported_results()[:1]
    monkeypatch.setattr(
        "vergence.eval.article.criterion.reported_results",
        lambda: (replace(row, experiment="toy", quantity="value", method="both", axis="x"),) * 2,
    )
    reproduce(config(tmp_path))
    said = report_text(tmp_path)
    order = [
        "1 of 1 results reproduced.", "within a factor of 1.25", "The article reports 2 results",
        "The article's results and ours", "Glossary", "Each of 5 values is a dot. They scatter.",
    ]  # fmt: skip
    assert [said.index(words) for words in order] == sorted(said.index(words) for words in order)


def test_the_tally_counts_each_result_of_the_article_once():
    rows = [
        {"experiment": r.experiment, "quantity": r.quantity, "method": r.method, "axis": r.axis,
         "verdict": "reproduced" if n < 5 else "differs"}
        for n, r in enumerate(reported_results())
    ]  # fmt: skip
    other = {**rows[0], "quantity": "another case"}
    section = ReportSection(
        name="all", title="", article="", what="", conclusion="", summary=[*rows, other],
        figures=[], rows=0, config={}, seed=0,
    )  # fmt: skip
    assert count_verdicts([section]) == {"reproduced": 5, "differs": len(rows) - 5}


def test_settings_that_say_nothing_are_refused():
    cases = [
        (["toy.draws"], "toy.draws"), (["draws=3"], "draws=3"), (["nonsense.draws=3"], "nonsense"),
        (["toy..draws=3"], "toy..draws"), (["toy.draws=3", "toy.draws.x=4"], "toy.draws.x=4"),
    ]  # fmt: skip
    assert not_refused(lambda words: read_overrides(None, words), cases) == []


def test_overrides_of_another_kind_than_the_default_are_refused(tmp_path):
    cases = [
        ({"nonsense": 1}, "nonsense"), ({"draws": 2.5}, "2.5"), ({"draws": True}, "True"),
        ({"scale": float("nan")}, "nan"), ({"depths": ["a"]}, "a"), ({"errors": 3.0}, "toy.errors"),
        ({"errors": {"link_mm": 3.0}}, "toy.errors.link_mm"),
        ({"errors": {"link_m": "far"}}, "far"), ({"errors": {"link_m": -1.0}}, "link_m"),
    ]  # fmt: skip

    def attempt(values):
        reproduce(config(tmp_path, overrides={"toy": values}))

    assert not_refused(attempt, cases) == []
    assert not (tmp_path / "run").exists()


def test_overrides_come_from_a_file_and_then_from_words(tmp_path):
    path = tmp_path / "config.toml"
    path.write_text("[toy]\ndraws = 3\nscale = 1.0\n")
    assert read_overrides(path, ["toy.scale=4", "toy.depths=[0.3, 0.4]"]) == {
        "toy": {"draws": 3, "scale": 4, "depths": [0.3, 0.4]}
    }


def test_a_part_of_a_configuration_is_set_by_its_own_fields(tmp_path):
    overrides = read_overrides(None, ["toy.errors.link-m=0.001", "toy.errors.principal_px=2"])
    reproduce(config(tmp_path, overrides=overrides))
    content = tomllib.loads((tmp_path / "run" / "config.toml").read_text())
    errors = content["experiments"]["toy"]["errors"]
    assert (errors["link_m"], errors["principal_px"], errors["head_eye_m"]) == (0.001, 2.0, 0.0)


def test_an_unknown_experiment_is_refused(tmp_path):
    with pytest.raises(UnknownNameError, match="nonsense"):
        reproduce(config(tmp_path, experiments=("nonsense",)))


def test_a_folder_with_other_things_in_it_is_left_alone(tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "mine.txt").write_text("kept")
    with pytest.raises(ConfigurationError, match=r"mine\.txt"):
        reproduce(config(tmp_path))
    assert [path.name for path in folder.iterdir()] == ["mine.txt"]
