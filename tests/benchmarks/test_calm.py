"""Laws about targets at rest with a robot's faults: which hold them, and what is a swing."""

import pandas as pd
import pytest

from benchmarks.calm import DESK, FAULTS, HEADS, Case, calm, cases, held, main
from tests.naming import named
from vergence.controllers.controller import make_controller
from vergence.eval.trials.run import run_trials


@pytest.mark.slow
def test_a_law_holds_its_target_where_speeds_are_read_late():
    for law, fault in (("saccade", "over 4 periods"), ("state-feedback", "filtered 80 ms")):
        with named(law, fault):
            found = held(Case("turrets", fault, law), 10)
            assert found["settled_2px_fraction"] == 1.0
            assert found["swinging_trials"] == 0
            assert found["fixation_peak_to_peak_median_deg_s"] < 3.0


@pytest.mark.slow
def test_trials_of_a_law_that_swings_are_counted_and_not_settled():
    scenario = Case("icub", "none", "ibvs").scenario()
    # four times the article's gain, on images that are up to 0.13 s late
    law = make_controller("ibvs", head=scenario.model(), gain=16.0)
    found = calm(run_trials(law, scenario, episodes=10))
    assert found["swinging_trials"] == 10
    assert found["settled_2px_fraction"] == 0.0
    assert found["fixation_peak_to_peak_median_deg_s"] > 20.0


@pytest.mark.nightly
def test_each_fault_is_in_all_trials_on_every_head():
    for case in cases(HEADS, [*FAULTS], ["saccade"]):
        scenario = case.scenario()
        for name, value in FAULTS[case.fault](scenario.model().timing).items():
            assert getattr(scenario.variation, name) == (value, value)
        scenario.task(1).close()
    assert [case.head for case in cases(HEADS, [DESK], ["saccade"])] == ["turrets"]


@pytest.mark.slow
def test_a_part_of_the_table_is_printed_and_kept(tmp_path, capsys):
    csv = tmp_path / "calm.csv"
    part = ["--head", "turrets", "--fault", "none", DESK, "--law", "saccade", "pursuit"]
    main(["--trials", "2", *part, "--csv", str(csv)])
    table = pd.read_csv(csv)
    assert list(table["fault"]) == ["none", "none", DESK, DESK]
    assert (table["trials"] == 2).all()
    assert DESK in capsys.readouterr().out
