"""Where a figure of the article falls in a population."""

import numpy as np
import pytest

from vergence.eval.article.twin.statistics import listed, ordinal, place, verdict

POPULATION = np.arange(101.0)


def test_a_figure_between_the_10th_and_90th_percentile_is_reproduced():
    placed = place(50.5, POPULATION)
    assert placed.inside
    assert (placed.low, placed.median, placed.high) == (10.0, 50.0, 90.0)
    assert placed.percentile == pytest.approx(100.0 * 51 / 101)
    assert verdict([placed, place(10.0, POPULATION)]) == "reproduced"


def test_the_verdict_says_on_which_side_ours_are():
    above, below = place(95.0, POPULATION), place(5.0, POPULATION)
    assert verdict([above]) == "smaller"
    assert verdict([below, place(50.0, POPULATION)]) == "larger"
    assert verdict([above, below]) == "other"


@pytest.mark.parametrize(
    ("percent", "words"),
    [(1.2, "1st"), (2.0, "2nd"), (83.4, "83rd"), (11.0, "11th"), (12.0, "12th"), (50.0, "50th")],
)
def test_ordinals(percent, words):
    assert ordinal(percent) == f"{words} percentile"


def test_lists_read_as_sentences():
    assert listed(["a"]) == "a"
    assert listed(["a", "b", "c"]) == "a, b and c"
