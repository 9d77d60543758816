"""Criterion by which a result of the article counts as reproduced."""

import math
from dataclasses import fields, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vergence.eval.article.criterion import (
    REPRODUCED_FACTOR,
    SAME_ORDER_FACTOR,
    most_different_ends,
    ratio_above_one,
    summarise_article,
    verdict_of_ranges,
)
from vergence.eval.article.experiment import SummaryRow
from vergence.eval.article.reported import reported_results
from vergence.reporting.report import write_report

ROW = {each.name: None for each in fields(SummaryRow)} | {"verdict": "differs"}
FIGURES = st.floats(1e-6, 1e6)


def test_the_worst_end_decides_and_overlap_does_not_count():
    expected = [
        ((1.0, 4.0), (1.0, 4.0), "reproduced"),
        ((0.81, 4.9), (1.0, 4.0), "reproduced"),
        ((1.0, 5.1), (1.0, 4.0), "same order"),
        ((0.5, 4.0), (1.0, 4.0), "same order"),
        ((0.119, 11.3), (0.119, 3.905), "same order"),  # they overlap, 2.9 times at the upper end
        ((0.1, 4.0), (1.0, 4.0), "differs"),
        ((2.0, 100.0), (1.0, 4.0), "differs"),
        ((525.0, 525.0), (650.0, 650.0), "reproduced"),
        ((500.0, 650.0), (650.0, 650.0), "same order"),
        ((0.03, 9.0), (0.03, None), "reproduced"),  # the article gives a least figure only
        ((0.03, 9.0), (None, 9.0), "reproduced"),
        ((-1.0, -1.0), (1.0, 1.0), "differs"),
        ((0.0, 1.0), (0.5, 1.0), "differs"),
        ((math.nan, 1.0), (1.0, 1.0), "none"),
    ]
    found = [(ours, article, verdict_of_ranges(*ours, *article)) for ours, article, _ in expected]
    assert found == expected


@given(FIGURES, FIGURES, FIGURES, FIGURES)
def test_what_is_reproduced_is_within_the_factor_at_both_ends(a, b, c, d):
    ours, article = sorted((a, b)), sorted((c, d))
    ratios = [ratio_above_one(*pair) for pair in zip(ours, article, strict=True)]
    said = verdict_of_ranges(*ours, *article)
    assert (said == "reproduced") == (max(ratios) <= REPRODUCED_FACTOR)
    assert (said == "differs") == (max(ratios) > SAME_ORDER_FACTOR)
    assert ratio_above_one(*most_different_ends(*ours, *article)) == max(ratios)


def test_the_factor_covers_how_far_the_articles_own_two_methods_are_apart_in_x_y_and_z():
    means = {
        (row.experiment, row.axis, row.method): row.low
        for row in reported_results()
        if row.quantity == "mean absolute error"
    }
    apart = [
        ratio_above_one(value, means[experiment, axis, "itpc"])
        for (experiment, axis, method), value in means.items()
        if method == "gaze"
    ]
    assert max(apart) == pytest.approx(1.24, abs=0.005)
    assert max(apart) < REPRODUCED_FACTOR


def test_a_report_without_a_reproduced_result_counts_none(tmp_path):
    article = replace(
        summarise_article([]), rows=[("gain-sweep", ROW)] * 2,
        tally={"differs": 2}, ratio=lambda row: "-",
    )  # fmt: skip
    write_report(tmp_path / "report.html", [], article=article)
    assert "0 of 2 results reproduced" in (tmp_path / "report.html").read_text()
