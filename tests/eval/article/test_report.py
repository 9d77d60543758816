"""The report as a browser shows it."""

import pytest

from tests.eval.article.browser import CHROMIUM, open_page
from vergence.eval.article.config import ReproduceConfig
from vergence.eval.article.reproduce import reproduce
from vergence.reporting.jobs import ProcessMapper

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def profile(tmp_path_factory):
    return tmp_path_factory.mktemp("browser")


@pytest.mark.skipif(not CHROMIUM, reason="no Chromium to open the report in")
@pytest.mark.usefixtures("toy")
def test_the_report_shows_every_figure_and_overflows_nowhere(tmp_path, profile):
    (section,) = reproduce(ReproduceConfig(out=tmp_path / "run"))
    for width in (400, 1400):
        page = open_page(tmp_path / "run" / "report.html", width, profile)
        assert page.console == []
        assert page.facts["inner"] == pytest.approx(width, abs=20)
        assert page.facts["scroll"] <= page.facts["inner"]
        assert page.facts["wide"] == []
        assert len(page.facts["drawn"]) == len(section.figures)
        assert all(w > 0.8 * min(width, 960) - 40 and h > 80 for w, h in page.facts["drawn"])


@pytest.mark.skipif(not CHROMIUM, reason="no Chromium to open a page in")
def test_the_browser_check_sees_errors_and_overflow(tmp_path, profile):
    bad = tmp_path / "bad.html"
    bad.write_text(
        "<!doctype html><head></head><body><script>console.error('broken')</script>"
        "<div style='width:3000px'>wide</div>"
    )
    page = open_page(bad, 400, profile)
    assert page.console
    assert page.facts["wide"]
    assert page.facts["scroll"] > page.facts["inner"]


@pytest.mark.nightly
@pytest.mark.skipif(not CHROMIUM, reason="no Chromium to open the report in")
def test_a_report_of_the_articles_experiments_shows_all_figures_at_both_widths(tmp_path, profile):
    names = ("gain-sweep", "time-response")
    options = ReproduceConfig(out=tmp_path / "run", quick=True, experiments=names)
    sections = reproduce(options, mapper=ProcessMapper(2))
    figures = sum(len(section.figures) for section in sections)
    for width in (400, 1400):
        page = open_page(tmp_path / "run" / "report.html", width, profile)
        assert page.console == []
        assert page.facts["scroll"] <= page.facts["inner"]
        assert page.facts["wide"] == []
        assert len(page.facts["drawn"]) == figures
        assert all(w > 300 and h > 80 for w, h in page.facts["drawn"])
