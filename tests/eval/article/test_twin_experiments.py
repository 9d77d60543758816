"""Properties of every experiment on the physical twin, in small runs."""

import pandas as pd
import pytest

from tests.eval.article.checks import incomplete, unjudged
from tests.eval.article.small_twin import NAMES, small, table_of, tiny_table
from tests.eval.mappers import Backwards
from vergence.eval.article.experiment import load_experiment
from vergence.reporting.jobs import SerialMapper

REPORTED = {
    "physical-static": "physical static",
    "physical-moving": "physical moving",
    "fixed-pair": "versus ZED Mini",
}
pytestmark = pytest.mark.slow


LATER = ("physical-moving", "physical-static")
NIGHTLY = [pytest.param(name, marks=pytest.mark.nightly) for name in LATER]


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["fixed-pair", *NIGHTLY])
def test_the_seed_draws_the_heads_and_who_runs_the_jobs_does_not_change_a_bit(name):
    one, again = (tiny_table(name, 0, mapper) for mapper in (SerialMapper(), Backwards()))
    pd.testing.assert_frame_equal(one, again, check_exact=True)
    assert not one.equals(tiny_table(name, 1, SerialMapper()))


@pytest.mark.parametrize("name", NAMES)
def test_the_summary_and_the_figures_have_all_of_the_article(name):
    experiment, table, config = load_experiment(name), table_of(name), small(name)
    assert unjudged(experiment.summarise(table, config), REPORTED[name]) == []
    assert incomplete(name, table, config) == []
