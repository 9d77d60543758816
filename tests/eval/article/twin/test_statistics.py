"""Position of the article's figures within a population."""

import numpy as np
import pytest

from vergence.eval.article.twin.statistics import (
    axis_columns,
    count_inside,
    rank_in_population,
    verdict,
)

POPULATION = np.arange(101.0)


def test_a_figure_between_the_10th_and_90th_percentile_is_inside():
    placed = rank_in_population(50.5, POPULATION)
    assert placed.inside
    assert (placed.low, placed.median, placed.high) == (10.0, 50.0, 90.0)
    assert placed.percentile == pytest.approx(100.0 * 51 / 101)
    assert verdict(placed) == verdict(rank_in_population(10.0, POPULATION)) == "inside"
    for value in (5.0, 95.0):
        assert verdict(rank_in_population(value, POPULATION)) == "outside"


def test_figures_inside_are_counted():
    ranks = [rank_in_population(value, POPULATION) for value in (5.0, 10.0, 50.0, 95.0)]
    assert count_inside(ranks) == 2


def test_columns_are_ordered_by_axis_and_then_by_name():
    columns = axis_columns(error=np.eye(3), scatter=np.ones((3, 3)))
    assert list(columns)[:3] == ["error_x_mm", "scatter_x_mm", "error_y_mm"]
    assert np.array_equal(columns["error_y_mm"], [0.0, 1.0, 0.0])
