"""The benchmark of Stable-Baselines3 runs each way of learning; what one learns is not tested."""

import pandas as pd
import pytest

from benchmarks.stable_baselines import main


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore:You are trying to run PPO on the GPU:UserWarning")
def test_a_short_look_has_a_row_for_every_way_of_learning(tmp_path, capsys) -> None:
    csv = tmp_path / "table.csv"
    main(["--seeds", "0", "--steps", "8", "--trials", "4", "--csv", str(csv)])
    table = pd.read_csv(csv)
    assert list(table["way"]) == ["recipe", "defaults", "defaults, 256 heads"]
    assert table["lost_fraction"].between(0.0, 1.0).all()
    assert (table["steps"] >= 8).all()
    assert "recipe" in capsys.readouterr().out
