"""The command line: what it prints, what it writes, and how it refuses."""

import json
import tomllib
from pathlib import Path

import mujoco
import numpy as np
import pandas as pd
import pytest

from tests.commands.called import call, refused
from tests.naming import named
from vergence.controllers.controller import default_options
from vergence.models import load_head, save_head


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """The folder of one gaze on drawn images."""
    folder = tmp_path_factory.mktemp("runs") / "gaze"
    assert call("gaze", "--out", folder, "--seed", "3") == 0
    return folder


@pytest.mark.slow
def test_a_gaze_writes_both_methods_and_a_row_per_control_period_from_time_zero(run):
    names = sorted(path.name for path in run.iterdir())
    assert names == ["config.toml", "gaze.png", "head.toml", "result.json", "trajectory.csv"]
    assert (run / "gaze.png").read_bytes().startswith(b"\x89PNG")
    result = json.loads((run / "result.json").read_text())
    assert result["truth_mm"] == pytest.approx([0.0, -100.0, 1000.0], abs=1e-4)
    assert 0.4 < result["settle_1px_s"] < result["settle_05px_s"] < 0.7
    assert result["gap_mm"] >= 0.0
    for method in ("gaze", "itpc"):
        fix = result[method]
        # the residual error at the trial's end is noise: five of its own sigmas are never exceeded
        assert np.abs(fix["error_mm"] / np.array(fix["sigma_mm"])).max() < 5.0
        assert np.subtract(fix["point_mm"], result["truth_mm"]) == pytest.approx(fix["error_mm"])
    table = pd.read_csv(run / "trajectory.csv")
    assert np.allclose(table["time_s"], np.arange(241) / 120.0)
    assert not table["visible_left"][:8].any()
    assert table["visible_left"][8:].all()


def test_the_config_says_what_was_run_with_which_versions(run):
    content = tomllib.loads((run / "config.toml").read_text())
    assert content["config"]["seed"] == 3
    assert content["config"]["plant"] == "rendered"
    assert content["versions"]["mujoco"] == mujoco.__version__
    assert load_head(run / "head.toml").digest == content["head"]["digest"]


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_json_is_the_result_and_nothing_else_and_that_of_a_seed(tmp_path, capsys):
    texts = []
    for name in ("a", "b"):
        call("gaze", "--json", "--plant", "mujoco", "--seed", "5", "--out", tmp_path / name)
        texts.append(capsys.readouterr().out)
        assert json.loads(texts[-1]) == json.loads((tmp_path / name / "result.json").read_text())
    assert texts[0] == texts[1]


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_controller_has_its_own_gain_or_none(tmp_path):
    for controller in ("pid", "saccade"):
        folder = tmp_path / controller
        words = ("--controller", controller, "--plant", "kinematic", "--out", folder)
        assert call("gaze", *words) == 0
        gain = default_options(controller).get("gain")
        assert json.loads((folder / "result.json").read_text())["gain"] == gain
        assert tomllib.loads((folder / "config.toml").read_text())["config"].get("gain") == gain


@pytest.mark.slow
def test_wrong_input_ends_in_one_clear_line_and_exit_code_2(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    # its images show more than its eyes can turn to
    head = load_head("simulated")
    limits = {"lower": head.limits.lower / 4.0, "upper": head.limits.upper / 4.0}
    save_head(head.replace(limits=limits), tmp_path / "narrow.toml")
    (tmp_path / "full").mkdir()
    (tmp_path / "full/mine.txt").touch()
    for words, said in (
        ("gaze --head nonsense", "'nonsense'"),
        ("gaze --plant nonsense", "'nonsense'"),
        ("gaze --controller nonsense", "'nonsense'"),
        ("gaze --gain -1", "-1"),
        ("gaze --gain 3 --controller saccade", "controller saccade: expected one of its options"),
        ("gaze --seed -4", "-4"),
        ("gaze --duration 0", "0"),
        ("gaze --duration nan", "nan"),
        ("gaze --point 0 -100 -1000", "behind"),
        ("gaze --point 0 -100 inf", "inf"),
        ("gaze --point 400 -100 1000 --head narrow.toml", "left_pan"),
        ("gaze --nonsense 1", "--nonsense"),
        ("gaze --plant kinematic --out full", "mine.txt"),
        ("export nonsense", "nonsense"),
        ("nonsense", "command: expected one of gaze, view, reproduce"),
        ("reproduce nonsense", "'nonsense'"),
        ("reproduce --set time-response.nonsense=1", "nonsense"),
        ("reproduce --set gain-sweep", "gain-sweep"),
        ("reproduce --config missing.toml", "missing.toml"),
        ("reproduce --workers -1", "-1"),
        ("reproduce --seed -1", "-1"),
    ):
        with named(words, said):
            assert said in refused(capsys, *words.split())
    assert {path.name for path in tmp_path.rglob("*")} == {"narrow.toml", "full", "mine.txt"}


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_eyes_that_do_not_settle_are_written_and_end_in_exit_code_1(tmp_path, capsys):
    folder = tmp_path / "run"
    assert call("gaze", "--plant", "kinematic", "--gain", "0.5", "--out", folder) == 1
    assert "did not settle" in capsys.readouterr().err
    assert json.loads((folder / "result.json").read_text())["settle_1px_s"] is None


def test_mjcf_is_exported_with_its_assets_and_loads_and_urdf_is(tmp_path, capsys):
    assert call("export", "mjcf", "--head", "physical", "--out", tmp_path / "mjcf") == 0
    models = [path for path in capsys.readouterr().out.split() if path.endswith(".xml")]
    assert models
    for path in models:
        assert mujoco.MjModel.from_xml_path(path).njnt == 7
    assert call("export", "urdf", "--out", tmp_path / "urdf") == 0
    (path,) = (path for path in capsys.readouterr().out.split() if path.endswith(".urdf"))
    assert "left_tilt" in Path(path).read_text()


def test_info_shows_versions_presets_and_optional_parts(capsys):
    assert call("info") == 0
    printed = capsys.readouterr().out
    for word in ("mujoco", "simulated", "physical", "rendered", "ibvs", "pygame"):
        assert word in printed


@pytest.mark.nightly
def test_reproduce_prints_the_articles_figures_beside_ours_and_keeps_results(tmp_path, capsys):
    folder = tmp_path / "run"
    words = ["reproduce", "time-response", "--quick", "--workers", "1", "--out", folder]
    assert call(*words) == 0
    printed = capsys.readouterr()
    assert "650 ms" in printed.out
    assert str(folder / "report.html") in printed.out.replace("\n", "")
    assert "time-response" in printed.err
    assert json.loads((folder / "summary.json").read_text())
    assert call(*words) == 0
    assert "kept from an earlier call" in capsys.readouterr().err
