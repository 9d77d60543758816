"""The figure of learning curves is made from run folders alone."""

from pathlib import Path

import pytest

from benchmarks.learning_curves import main

HEADER = "step,headline,settled_fraction,mean,baseline,gain,reward,length,steps_per_s,best\n"


def run_folder(folder: Path, kind: str, seed: int) -> Path:
    folder.mkdir()
    config = f'[config]\nkind = "{kind}"\nseed = {seed}\nsteps = 2000\n'
    (folder / "config.toml").write_text(config)
    rows = "0,2.0,0.0,2.0,0.65,0.3,,,0,True\n2000,0.31,1.0,0.3,0.65,2.1,70.0,120.0,9000,True\n"
    (folder / "curve.csv").write_text(HEADER + rows)
    return folder


@pytest.mark.nightly
def test_runs_of_both_kinds_make_one_picture_and_a_table(tmp_path, capsys) -> None:
    runs = [
        run_folder(tmp_path / f"{kind}-{seed}", kind, seed)
        for kind in ("gain-schedule", "policy")
        for seed in range(5)
    ]
    out = tmp_path / "curves"
    assert main([*map(str, runs), "--out", str(out)]) == 0
    assert out.with_suffix(".png").stat().st_size > 10_000
    shown = capsys.readouterr().out
    assert shown.count("0.310") == len(runs)  # what the best checkpoint reached, not the first row
    assert "100.0%" in shown
