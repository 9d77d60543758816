"""The benchmark of controllers runs and writes what it promises; how fast one is, no test says."""

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).resolve().parents[2] / "benchmarks" / "controllers.py"


@pytest.mark.slow
def test_a_quick_run_writes_a_row_for_every_controller(tmp_path: Path) -> None:
    table = tmp_path / "controllers.json"
    done = subprocess.run(
        [sys.executable, str(BENCHMARK), "ibvs", "--quick", "--json", str(table)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    rows = json.loads(table.read_text())
    assert [row["name"] for row in rows] == ["ibvs", "ibvs-tuned"]
    for row in rows:
        assert row["name"] in done.stdout
        for key in ("one_us", "batch_us"):
            assert math.isfinite(row[key])
            assert row[key] > 0
    assert rows[1]["one_ratio"] == rows[1]["batch_ratio"] == 1.0
