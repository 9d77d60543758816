"""Trials beyond those that were learned from: what is moved, by how much, and what is told."""

import numpy as np
import pandas as pd
import pytest

from benchmarks.beyond_training import CONTROLLERS, main, outside
from vergence.eval.trials.loops import HARDWARE_LOOP


def test_each_imperfection_is_outside_of_what_was_learned_from_and_the_others_are_not() -> None:
    cases = outside(HARDWARE_LOOP)
    assert cases.pop("none") is HARDWARE_LOOP
    moved = set()
    for variation in cases.values():
        differ = {
            name
            for name in vars(HARDWARE_LOOP)
            if getattr(variation, name) != getattr(HARDWARE_LOOP, name)
        }
        assert differ
        moved |= differ
        for name in differ - {"model_errors"}:
            low, high = getattr(HARDWARE_LOOP, name)
            (value, same) = getattr(variation, name)
            assert value == same
            assert not low <= value <= high
    # when a target appears, where in a period a frame lies and clocks' drift are no faults
    drawn = {name for name, span in vars(HARDWARE_LOOP).items() if span is not None}
    assert drawn - moved == {"onset_s", "frame_phase", "clock_drift"}


@pytest.mark.nightly
def test_the_table_has_a_row_for_each_imperfection_and_controller(tmp_path, capsys) -> None:
    csv = tmp_path / "beyond.csv"
    main(["--episodes", "6", "--only", "none", "frame jitter", "--csv", str(csv)])
    table = pd.read_csv(csv)
    assert list(table["imperfection"]) == ["none"] * 5 + ["frame jitter"] * 5
    assert list(table["controller"]) == 2 * [*CONTROLLERS]
    saccade = table[table["controller"] == "saccade"].iloc[0]
    assert saccade["settled_2px_fraction"] == 1.0
    assert 0.15 < saccade["settle_2px_median_s"] <= saccade["settle_2px_p95_s"] < 0.8
    assert 1.0 <= saccade["ratio_to_bound_2px_median"] <= saccade["ratio_to_bound_2px_p95"]
    assert np.isfinite(table["settled_2px_fraction"]).all()
    assert "frame jitter" in capsys.readouterr().out
