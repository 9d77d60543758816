"""`vergence evaluate --margins` as a person runs it."""

import json

import pytest

from tests.commands.called import run

FEW = ("--trials", "2", "--workers", "1")


@pytest.mark.usefixtures("undrawn")
@pytest.mark.nightly
def test_the_table_names_what_was_moved_and_how_far_it_may_be(capsys, tmp_path):
    code, out, _err = run(
        capsys, "evaluate", "ibvs", "--margins", "--imperfection", "command_latency_s", *FEW,
        "--out", tmp_path / "run",
    )  # fmt: skip
    assert code == 0
    for words in (
        "ibvs in workspace on kinematic: 2 of 2 trials settle untouched", "command latency (ms)",
        "0 to 100", "99 % settle", "median not doubled", "written to",
    ):  # fmt: skip
        assert words in out
    for name in ("margins.json", "margins.csv", "points.csv", "config.toml", "report.html"):
        assert (tmp_path / "run" / name).is_file()


@pytest.mark.nightly
@pytest.mark.usefixtures("undrawn")
def test_json_alone_on_standard_output(capsys, tmp_path):
    code, out, _err = run(
        capsys, "evaluate", "ibvs", "pid", "--margins", "--imperfection", "frame_phase",
        *FEW, "--json", "--out", tmp_path / "run",
    )  # fmt: skip
    assert code == 0
    rows = json.loads(out)
    assert [row["controller"] for row in rows] == ["ibvs", "pid"]
    assert rows == json.loads((tmp_path / "run" / "margins.json").read_text())


def test_a_mistake_is_one_line_and_leaves_nothing(capsys, tmp_path):
    for words, said in [
        (("--margins", "--imperfection", "delay"), "imperfection: expected one of"),
        (("--imperfection", "lag_s"), "imperfection: expected none without --margins"),
        (("--margins", "--scenario", "fast"), "never comes to rest"),
        (("--margins", "--plant", "kinematic", "mujoco"), "plant: expected one with --margins"),
        (("--margins", "--trials", "0"), "episodes: expected at least 1, got 0"),
    ]:
        words = ("evaluate", "ibvs", *words, "--workers", "1", "--out", tmp_path / "run")
        code, out, err = run(capsys, *words)
        assert code == 2
        assert out == ""
        (line,) = [line for line in err.splitlines() if "error: " in line]
        assert said in line
        assert not (tmp_path / "run").exists()
