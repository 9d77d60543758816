"""The benchmark of the start counts every process of a command; how quick one is, no test says."""

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.start import ROOT

BUSY = "import time\nwhile time.process_time() < 0.5: pass"
"""Half a second of CPU time."""
ORPHANING = f"import subprocess, sys; subprocess.Popen([sys.executable, '-c', {BUSY!r}])"
"""Starts a process and ends before it."""


def run(*words: str) -> str:
    done = subprocess.run(
        [sys.executable, *words], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_a_process_that_nobody_waits_for_is_counted() -> None:
    code = (
        "from benchmarks.start import adopt_orphans, cpu_seconds; adopt_orphans(); "
        f"print(cpu_seconds(['-c', {ORPHANING!r}]))"
    )
    assert float(run("-c", code)) > 0.5


@pytest.mark.slow
def test_a_run_beside_a_base_writes_a_row_for_every_case(tmp_path: Path) -> None:
    table = tmp_path / "start.json"
    words = ("numpy", "import", "--base", "HEAD", "--rounds", "1", "--json", str(table))
    shown = run("-m", "benchmarks.start", *words)
    rows = json.loads(table.read_text())
    assert [row["case"] for row in rows] == ["numpy", "import"]
    for row in rows:
        assert row["base_cpu_s"] > 0.0
        assert math.isclose(row["now_ratio"], row["now_cpu_s"] / row["base_cpu_s"])
        assert row["case"] in shown
