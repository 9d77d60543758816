"""The benchmark of returns, and what the reward is for: what looks better earns more."""

from itertools import pairwise

import pandas as pd
import pytest

from benchmarks.returns import DISCOUNTS, main
from tests.naming import named


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    csv = tmp_path_factory.mktemp("returns") / "returns.csv"
    main(["--trials", "48", "--csv", str(csv)])
    return pd.read_csv(csv).set_index(["scenario", "policy"])


@pytest.mark.slow
def test_what_looks_better_at_the_target_earns_more(table) -> None:
    order = ["full speed", "still", "ibvs, half the gain", "ibvs, tuned gain", "saccade"]
    for scenario in ("workspace", "robust"):
        for discount in DISCOUNTS:
            with named(scenario, discount):
                earned = table.loc[scenario][f"return_{discount:g}"]
                assert list(earned.index) == order
                assert all(worse < better for worse, better in pairwise(earned))


@pytest.mark.slow
def test_full_speed_loses_the_target_and_nothing_else_does(table) -> None:
    lost = table["lost"].unstack("policy")
    assert (lost["full speed"] > 0.9).all()
    assert (lost.drop(columns="full speed") == 0.0).all(axis=None)
