"""Properties of every experiment on the physical twin, in small runs."""

import pandas as pd
import pytest

from tests.eval.article.checks import backwards, stale_names, uncaptioned, unjudged
from tests.eval.article.twin.small import NAMES, small, table_of, tiny_table
from vergence.eval.article.experiment import load_experiment
from vergence.eval.jobs import SerialMapper

REPORTED = {
    "physical-static": "physical static",
    "physical-moving": "physical moving",
    "fixed-pair": "versus ZED Mini",
}
every = pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow if name == "physical-static" else ())
        for name in NAMES
    ],
)


@pytest.mark.slow
@every
def test_the_seed_draws_the_heads_and_who_runs_the_jobs_does_not_change_a_bit(name):
    one, again = (tiny_table(name, 0, mapper) for mapper in (SerialMapper(), backwards))
    pd.testing.assert_frame_equal(one, again, check_exact=True)
    assert not one.equals(tiny_table(name, 1, SerialMapper()))


@pytest.mark.slow
@every
def test_the_summary_judges_every_result_of_the_article(name):
    rows = load_experiment(name).summarise(table_of(name), small(name))
    assert unjudged(rows, REPORTED[name]) == []


@every
def test_no_panel_of_a_figure_is_empty(name):
    figures = load_experiment(name).draw(table_of(name), small(name))
    assert figures
    for figure in figures.values():
        for panel in figure.axes:
            assert panel.has_data()
            assert panel.get_xlabel()


@every
def test_the_docs_keep_numbers_of_these_names(name):
    assert stale_names(name, table_of(name), small(name)) == set()
    assert uncaptioned(load_experiment(name), table_of(name), small(name)) == set()
