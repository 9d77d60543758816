"""The benchmark of Stable-Baselines3 runs each way of learning; what one learns is not tested."""

import runpy
import sys

import gymnasium
import pandas as pd
import pytest

from benchmarks.stable_baselines import RECIPE, main


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


@pytest.mark.slow
def test_the_recipe_judges_on_the_head_and_the_loop_that_it_learned_on(monkeypatch, tmp_path):
    made, original = [], gymnasium.make_vec

    def make_vec(*names, **options):
        made.append([options[name] for name in ("head", "plant", "variation")])
        return original(*names, **options)

    monkeypatch.setattr(gymnasium, "make_vec", make_vec)
    zip_file = tmp_path / "gaze.zip"
    words = f"{RECIPE} --head turrets --robot --steps 8 --save {zip_file}"
    monkeypatch.setattr(sys, "argv", words.split())
    runpy.run_path(str(RECIPE), run_name="__main__")
    learning, judging = made
    assert learning == judging
    assert learning[0] == "turrets"
    assert learning[2]["latency_s"] == (0.05, 0.1)
    assert zip_file.is_file()


def test_the_recipe_refuses_an_unknown_head_in_one_line(monkeypatch, capsys) -> None:
    monkeypatch.setattr(sys, "argv", [str(RECIPE), "--head", "turret"])
    with pytest.raises(SystemExit, match="2"):
        runpy.run_path(str(RECIPE), run_name="__main__")
    (line,) = capsys.readouterr().err.splitlines()
    assert "did you mean turrets?" in line
