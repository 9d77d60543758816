"""The benchmark of the start measures every case; how quick one is, no test says."""

import json
import math
import subprocess
import sys

import pytest

from benchmarks.start import ROOT


@pytest.mark.nightly
def test_a_run_beside_a_base_writes_a_row_for_every_case(tmp_path) -> None:
    table = tmp_path / "start.json"
    words = ("numpy", "import", "--base", "HEAD", "--rounds", "1", "--json", str(table))
    command = [sys.executable, "-m", "benchmarks.start", *words]
    subprocess.run(command, cwd=ROOT, capture_output=True, check=True)
    rows = json.loads(table.read_text())
    assert [row["case"] for row in rows] == ["numpy", "import"]
    for row in rows:
        assert row["base_cpu_s"] > 0.0
        assert math.isclose(row["now_ratio"], row["now_cpu_s"] / row["base_cpu_s"])
