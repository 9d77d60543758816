"""The section of one run's report dropped into another's."""

import json
import shutil

import pytest

from tests.eval.refusals import not_refused
from vergence.errors import ConfigurationError
from vergence.eval.article.config import ReproduceConfig
from vergence.eval.article.reproduce import reproduce
from vergence.eval.comparison.folder import write_evaluation
from vergence.eval.reporting.section import SECTION_FILE, read_section


@pytest.fixture
def run(few_folder):
    return few_folder


@pytest.mark.slow
@pytest.mark.usefixtures("toy", "undrawn")
def test_an_evaluation_joins_the_report_and_stays_in_it(tmp_path, run):
    out = tmp_path / "out"
    sections = reproduce(ReproduceConfig(out=out, include=(run,)))
    assert [section.name for section in sections] == ["toy", "evaluation-first-run"]
    report = (out / "report.html").read_text()
    assert 'id="evaluation-first-run"' in report
    assert "times the time-optimal bound" in report
    assert "The article, reproduced and judged" in report
    assert (out / sections[1].data).is_file()
    for include in ((), (run,)):  # included twice, it is there once
        again = reproduce(ReproduceConfig(out=out, include=include))
        assert [section.name for section in again] == ["toy", "evaluation-first-run"]


@pytest.mark.usefixtures("toy")
def test_a_folder_that_is_no_evaluation_is_refused_before_anything_is_written(tmp_path):
    (tmp_path / "other").mkdir()
    config = ReproduceConfig(out=tmp_path / "out", include=(tmp_path / "other",))
    with pytest.raises(ConfigurationError, match="include: expected the folder of a run"):
        reproduce(config)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_section_shows_no_file_but_its_own_figures(tmp_path, run):
    content = json.loads((run / SECTION_FILE).read_text())
    (tmp_path / "secret.svg").write_text("<svg></svg>")
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "evaluation.json").write_text("[]")

    def attempt(figure):
        section = json.dumps({**content, "figures": [figure]})
        (tmp_path / "run" / SECTION_FILE).write_text(section)
        read_section(tmp_path / "run" / SECTION_FILE)

    files = ("../secret.svg", "figures/none.svg", "evaluation.json")
    cases = [(file, "include: expected a figure of the run") for file in files]
    assert not_refused(attempt, cases) == []


@pytest.mark.slow
def test_a_section_is_read_as_it_was_written(run):
    section = read_section(run / SECTION_FILE)
    assert section.tables[0].columns[0] == "controller"
    assert section.tables[0].rows[-1][0].startswith("bound")
    assert len(section.figures) == 4
    assert section.rows == 24
    assert all(section.captions[figure.stem].endswith(".") for figure in section.figures)


@pytest.mark.nightly
def test_the_figures_of_an_evaluation_are_drawn(tmp_path, few):
    write_evaluation(tmp_path, few)
    sizes = [path.stat().st_size for path in (tmp_path / "figures").iterdir()]
    assert len(sizes) == 8
    assert min(sizes) > 5000


NO_RUN = "include: expected the folder of a run"


@pytest.mark.slow
def test_a_section_with_values_of_another_type_is_refused(tmp_path, run):
    values = [
        ("what", 3), ("rows", "many"), ("summary", [{"experiment": "x"}]),
        ("tables", [{"title": "x", "columns": ["a"], "rows": [[1]]}]), ("tables", {"title": "x"}),
        ("figures", 5),
    ]  # fmt: skip
    copy = shutil.copytree(run, tmp_path / "run")
    content = json.loads((copy / SECTION_FILE).read_text())

    def attempt(field):
        (copy / SECTION_FILE).write_text(json.dumps({**content, field[0]: field[1]}))
        read_section(copy / SECTION_FILE)

    assert not_refused(attempt, [(value, NO_RUN) for value in values]) == []


def test_a_section_that_is_no_json_is_refused(tmp_path):
    def attempt(text):
        (tmp_path / SECTION_FILE).write_text(text)
        read_section(tmp_path / SECTION_FILE)

    texts = ("", "{", "[" * 10_000, "[]")
    assert not_refused(attempt, [(text, NO_RUN) for text in texts]) == []


@pytest.mark.slow
def test_a_section_whose_figure_is_cut_is_refused(tmp_path, run):
    copy = shutil.copytree(run, tmp_path / "run")
    figure = next((copy / "figures").glob("*.svg"))
    figure.write_bytes(figure.read_bytes()[:-20])
    with pytest.raises(ConfigurationError, match="include: expected a whole SVG file"):
        read_section(copy / SECTION_FILE)


@pytest.mark.slow
@pytest.mark.usefixtures("toy", "undrawn")
def test_an_included_run_that_was_damaged_since_is_refused_before_the_work(tmp_path, run):
    out = tmp_path / "out"
    log = tmp_path / "log"
    reproduce(ReproduceConfig(out=out, include=(run,)))
    (out / "evaluations" / "first-run" / SECTION_FILE).write_text("{")
    with pytest.raises(ConfigurationError, match=r"include: .*evaluations.first-run"):
        reproduce(ReproduceConfig(out=out, set=(f"toy.log={str(log)!r}",)))
    assert not log.exists()
    reproduce(ReproduceConfig(out=out, include=(run,)))  # included again, it is whole again
