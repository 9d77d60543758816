"""`--parquet` writes Parquet beside CSV, and says before any work what it lacks."""

import sys

import pandas as pd
import pytest

from tests.commands.called import call, refused


@pytest.mark.usefixtures("undrawn")
def test_a_gaze_writes_its_trajectory_as_parquet_too(tmp_path):
    words = ("gaze", "--plant", "kinematic", "--json", "--parquet", "--out", tmp_path / "run")
    assert call(*words) == 0
    csv = pd.read_csv(tmp_path / "run" / "trajectory.csv")
    parquet = pd.read_parquet(tmp_path / "run" / "trajectory.parquet")
    pd.testing.assert_frame_equal(parquet, csv, check_exact=True)


def test_without_pyarrow_one_line_names_the_extra_before_any_work(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    for command in ("gaze", "evaluate", "reproduce"):
        said = refused(capsys, command, "--parquet", "--out", tmp_path / "run")
        assert "pip install 'vergence[parquet]' (in a clone: pip install '.[parquet]')" in said
        assert list(tmp_path.iterdir()) == []
