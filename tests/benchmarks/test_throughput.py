"""The benchmark runs and writes what it promises; how fast anything is, no test says."""

import importlib.util
import json
import math
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).resolve().parents[2] / "benchmarks" / "throughput.py"
NAMES = [
    "bare",
    "single_mujoco",
    "vector_mujoco_1024",
    "vector_kinematic_1024",
    "vector_hardware_1024",
    "rendered_stereo",
    "reacher_single",
    "reacher_sync_16",
    "envpool_reacher_256",
    "control_step_us",
]


@pytest.mark.slow
def test_a_quick_run_writes_a_row_for_every_case(tmp_path: Path) -> None:
    table = tmp_path / "throughput.json"
    done = subprocess.run(
        [sys.executable, str(BENCHMARK), "--quick", "--json", str(table)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    rows = json.loads(table.read_text())
    expected = list(NAMES)
    for name, needs in (
        ("reacher_single", "glfw"),
        ("reacher_sync_16", "glfw"),
        ("envpool_reacher_256", "envpool"),
    ):
        if importlib.util.find_spec(needs) is None:
            expected.remove(name)
            assert f"{name}: left out" in done.stderr
    assert [row["name"] for row in rows] == expected
    for row in rows:
        assert math.isfinite(row["steps_per_s"])
        assert row["steps_per_s"] > 0
        assert math.isclose(row["ratio_to_bare"], row["steps_per_s"] / rows[0]["steps_per_s"])
        assert row["name"] in done.stdout
    assert math.isclose(rows[-1]["median_us"] * rows[-1]["steps_per_s"], 1e6)
    assert [path.name for path in tmp_path.iterdir()] == [table.name]
