"""The benchmark of controllers runs and writes what it promises; how fast one is, no test says."""

import json

import pytest

from benchmarks.controllers import main


@pytest.mark.nightly
def test_a_quick_run_writes_a_row_for_every_controller(tmp_path, capsys) -> None:
    table = tmp_path / "controllers.json"
    main(["ibvs", "--quick", "--json", str(table)])
    rows, out = json.loads(table.read_text()), capsys.readouterr().out
    assert [row["name"] for row in rows] == ["ibvs", "ibvs-tuned"]
    assert all(row["name"] in out and row["one_us"] > 0 and row["batch_us"] > 0 for row in rows)
    assert rows[1]["one_ratio"] == rows[1]["batch_ratio"] == 1.0
