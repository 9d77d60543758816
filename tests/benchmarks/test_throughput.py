"""The benchmark runs and writes what it promises; how fast anything is, no test says."""

import importlib.util
import json
import math

import pytest

from benchmarks.throughput import main

NAMES = [
    "bare", "single_mujoco", "vector_mujoco_1024", "vector_kinematic_1024", "vector_hardware_1024",
    "rendered_stereo", "reacher_single", "reacher_sync_16", "envpool_reacher_256",
    "control_step_us",
]  # fmt: skip
NEEDS = {"reacher_single": "glfw", "reacher_sync_16": "glfw", "envpool_reacher_256": "envpool"}


@pytest.mark.nightly
def test_a_quick_run_writes_a_row_for_every_case(tmp_path, capsys) -> None:
    table = tmp_path / "throughput.json"
    main(["--quick", "--json", str(table)])
    out, err = capsys.readouterr()
    rows = json.loads(table.read_text())
    missing = {name for name, needs in NEEDS.items() if importlib.util.find_spec(needs) is None}
    assert all(f"{name}: left out" in err for name in missing)
    assert [row["name"] for row in rows] == [name for name in NAMES if name not in missing]
    for row in rows:
        assert row["steps_per_s"] > 0
        assert math.isclose(row["ratio_to_bare"], row["steps_per_s"] / rows[0]["steps_per_s"])
        assert row["name"] in out
    assert math.isclose(rows[-1]["median_us"] * rows[-1]["steps_per_s"], 1e6)
