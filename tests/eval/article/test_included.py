"""The section of an evaluation dropped into the article's report."""

import pytest

from vergence.errors import ConfigurationError
from vergence.eval.article.config import ReproduceConfig
from vergence.eval.article.reproduce import reproduce
from vergence.reporting.report import SECTION_FILE


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
