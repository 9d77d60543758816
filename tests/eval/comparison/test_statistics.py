"""Bootstrap intervals: the same for the same seed, as wide as theory says, paired."""

import numpy as np
import pytest

from vergence.eval.comparison.statistics import Bootstrap, mean, median, p95


def test_the_same_seed_gives_the_same_interval_and_another_another():
    values = np.random.default_rng(0).exponential(size=200)
    one = Bootstrap(200, seed=3).interval(values, median)
    assert one == Bootstrap(200, seed=3).interval(values, median)
    assert one != Bootstrap(200, seed=4).interval(values, median)
    assert one.low < one.value < one.high


def test_the_interval_of_a_mean_is_that_of_the_normal_approximation():
    values = np.random.default_rng(1).normal(size=2000)
    interval = Bootstrap(2000).interval(values, mean)
    half = 1.96 * values.std() / np.sqrt(2000)
    # a thousand resamples give the ends of the interval to some 5 %
    assert interval.high - interval.value == pytest.approx(half, rel=0.15)
    assert interval.value - interval.low == pytest.approx(half, rel=0.15)


def test_an_interval_is_nothing_for_equal_values_and_within_0_and_1_for_a_fraction():
    assert Bootstrap(50).interval(np.full(50, 2.0), median) == (2.0, 2.0, 2.0)
    interval = Bootstrap(100).interval(np.arange(100) < 97, mean)
    assert interval.value == 0.97
    assert 0.9 < interval.low < 0.97 < interval.high <= 1.0


def test_infinite_values_count_and_do_not_spoil_the_rest():
    values = np.where(np.arange(100) < 8, np.inf, 1.0)
    assert Bootstrap(100).interval(values, median).value == 1.0
    assert np.isinf(Bootstrap(100).interval(values, p95).value)
    assert not np.isnan(Bootstrap(100).interval(values, p95).low)
    assert p95(np.arange(1.0, 101.0)) == 96.0


def test_the_ratio_of_paired_trials_is_certain_where_one_is_a_multiple_of_the_other():
    values = np.random.default_rng(2).exponential(size=301)
    interval = Bootstrap(301).ratio(3.0 * values, values, median)
    assert interval == pytest.approx((3.0, 3.0, 3.0))


def test_resampling_in_blocks_covers_all_resamples():
    # more numbers than one block holds
    bootstrap = Bootstrap(30_000, resamples=100)
    assert len(bootstrap._blocks) > 1
    assert len(bootstrap._resampled(np.arange(30_000.0), mean)) == 100


def test_a_thousand_of_a_thousand_do_not_prove_a_certainty():
    every = Bootstrap(1000).interval(np.ones(1000, dtype=bool), mean)
    none = Bootstrap(1000).interval(np.zeros(1000, dtype=bool), mean)
    # the rule of three, for 2.5 % on one side: -ln(0.025) / n
    assert every == pytest.approx((1.0, 1.0 - 3.69 / 1000, 1.0), abs=1e-5)
    assert none == pytest.approx((0.0, 0.0, 3.69 / 1000), abs=1e-5)
