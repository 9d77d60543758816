"""Settling to 2 px beside 1 px, and the band by which a scenario says who is faster."""

import json

import numpy as np
import pytest

from tests.eval.conftest import row_of
from tests.eval.trials.toys import PERIOD_S, InTwoTurns, KnowsTheWay
from vergence.eval.comparison.evaluate import (
    BOUND,
    EvaluateConfig,
    Evaluation,
    evaluate,
    row_fields,
)
from vergence.eval.comparison.folder import write_evaluation
from vergence.eval.comparison.statistics import speed_up
from vergence.eval.trials.settling import SettlingBand

NEAR = InTwoTurns(20, 50, 1.5)
"""Within 2 px after 21 periods, within 1 px after 51."""
TWO_PX = (
    "settled_2px_fraction", "settle_2px_median_s", "settle_2px_p95_s", "ratio_to_bound_2px_median",
    "ratio_to_bound_2px_p95",
)  # fmt: skip


@pytest.fixture
def run(known):
    def evaluated(band_px: float = 1.0, **toys: object) -> Evaluation:
        known(band_px=band_px)
        return evaluate(EvaluateConfig(scenarios=("known",), episodes=20), toys)

    return evaluated


def outcome_of(evaluation: Evaluation, controller: str):
    (one,) = (one for one in evaluation.outcomes if one.controller == controller)
    return one


def test_a_row_has_the_times_to_two_pixels_beside_those_to_one(run) -> None:
    evaluation = run(near=NEAR)
    row, bound = row_of(evaluation, "near"), row_of(evaluation, BOUND)
    assert row["settled_2px_fraction"] == row["settled_fraction"] == 1.0
    assert row["settle_2px_median_s"] == pytest.approx(21 * PERIOD_S, abs=1e-12)
    assert row["settle_2px_p95_s"] == pytest.approx(21 * PERIOD_S, abs=1e-12)
    assert row["settle_1px_median_s"] == pytest.approx(51 * PERIOD_S, abs=1e-12)
    ratio = row["settle_2px_median_s"] / bound["settle_2px_median_s"]
    assert row["ratio_to_bound_2px_median"] == pytest.approx(ratio)
    assert row["ratio_to_bound_2px_p95"] == pytest.approx(ratio)
    assert bound["settled_2px_fraction"] == bound["ratio_to_bound_2px_median"] == 1.0
    assert bound["settle_2px_median_s"] <= bound["settle_1px_median_s"]
    assert all(name in json.loads(json.dumps(row)) for name in TWO_PX)


def test_what_never_settles_to_one_pixel_may_settle_to_two(run) -> None:
    row = row_of(run(near=InTwoTurns(20, 1000, 1.5)), "near")
    assert row["settled_2px_fraction"] == 1.0
    assert row["settled_fraction"] == 0.0
    assert row["ratio_to_bound_2px_median"] >= 1.0
    assert row["ratio_to_bound_median"] is None


@pytest.mark.slow
def test_ratios_are_of_trials_that_settled(run) -> None:
    toys = {"some": KnowsTheWay(20, never=(0, 5)), "most": KnowsTheWay(20, never=tuple(range(11)))}
    evaluation = run(**toys)
    some, most = row_of(evaluation, "some"), row_of(evaluation, "most")
    plain = row_of(run(all=KnowsTheWay(20)), "all")
    assert some["ratio_to_bound_median"] == pytest.approx(plain["ratio_to_bound_median"])
    # two of twenty are beyond the 95th percentile: a failure has no ratio, not a small one
    for name in ("ratio_to_bound_p95", "ratio_to_bound_2px_p95"):
        assert some[name] is None
    for name in ("ratio_to_bound_median", "ratio_to_bound_2px_median"):
        assert most[name] is None
    table = outcome_of(evaluation, "some").trials
    assert np.isinf(table["ratio_to_bound"]).sum() == 2
    assert np.isinf(table["ratio_to_bound_2px"]).sum() == 2


@pytest.mark.slow
def test_the_leading_band_decides_who_is_faster(run) -> None:
    for band_px, faster in {1.0: 41 / 51, 2.0: 41 / 21}.items():
        evaluation = run(band_px, near=NEAR, steady=KnowsTheWay(40))
        near, steady = (outcome_of(evaluation, name) for name in ("near", "steady"))
        assert near.band_px == band_px
        found = speed_up(near.trials, steady.trials, False, band_px, seed=0)
        assert found["faster"] == pytest.approx(faster)


@pytest.mark.usefixtures("undrawn")
def test_any_band_may_lead(run, tmp_path) -> None:
    band_px = 3.0
    evaluation = run(band_px, near=InTwoTurns(20, 50, 0.8 * band_px))
    write_evaluation(tmp_path, evaluation)
    band = SettlingBand(band_px)
    row, bound = row_of(evaluation, "near"), row_of(evaluation, BOUND)
    assert row[band.settled_fraction_column] == 1.0
    assert row[band.settle_median_s_column] == pytest.approx(21 * PERIOD_S, abs=1e-12)
    ratio = row[band.settle_median_s_column] / bound[band.settle_median_s_column]
    assert row[band.ratio_median_column] == pytest.approx(ratio)
    report = (tmp_path / "report.html").read_text()
    assert f"median settle time to {band_px:g} px" in " ".join(report.split())


def test_scenarios_of_other_bands_add_nothing_to_a_row(run) -> None:
    assert tuple(row_of(run(2.0, near=NEAR), "near")) == row_fields(1.0)


def test_nothing_is_faster_where_less_than_half_of_the_trials_settled(run) -> None:
    few = KnowsTheWay(20, never=tuple(range(11)))
    evaluation = run(few=few, steady=KnowsTheWay(40))
    tables = [outcome_of(evaluation, name).trials for name in ("few", "steady")]
    for ours, theirs in (tables, tables[::-1]):
        assert np.isnan(speed_up(ours, theirs, False, 1.0, seed=0)["faster"])
    # the printed tables compare with a baseline that does not settle in half a second
    (row,) = (row for row in evaluation.summaries() if row["controller"] == "steady")
    assert np.isnan(row["faster"])
