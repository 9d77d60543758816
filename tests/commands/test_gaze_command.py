"""`vergence gaze` as a person reads it."""

import re
from dataclasses import replace

import numpy as np
import pytest

from tests.commands.called import call
from tests.heads import text_of
from vergence.commands.gaze import _print_gaze as show
from vergence.commands.gaze import _verdict as verdict
from vergence.eval.gaze import run_gaze
from vergence.eval.gaze_config import GazeConfig


@pytest.fixture(scope="module")
def result():
    return run_gaze(GazeConfig(duration_s=0.2))


def test_the_table_explains_its_methods_and_cuts_no_number(capsys, monkeypatch, result):
    for columns in (40, 60, 80):
        monkeypatch.setenv("COLUMNS", str(columns))
        show(result)
        out = capsys.readouterr().out
        said = " ".join(out.split())
        assert "gaze: where the optical axes cross" in said
        assert "ITPC (integrated two-pose calibration)" in said
        assert "…" not in out
        for fix in (result.gaze_fix, result.view_fix):
            for value in (*fix.point[0], *fix.sigma[0]):
                assert re.search(rf"(?<![\d.]){re.escape(f'{1e3 * value:z.3f}')}(?!\d)", out)


def test_what_rounds_to_zero_is_printed_without_a_sign(capsys, result):
    point = result.true_target_m + np.array([-1e-9, 1e-9, -1e-8])
    fix = result.gaze_fix._replace(point=point[None], gap=np.array([-0.0]))
    exact = replace(
        result, gaze_fix=fix, view_fix=fix,
        true_target_m=np.where(result.true_target_m, result.true_target_m, -0.0),
    )  # fmt: skip
    show(exact)
    assert not re.search(r"[-+]0\.0+(?!\d)", capsys.readouterr().out)


@pytest.mark.usefixtures("undrawn")
def test_a_robot_is_not_asked_for_a_target_in_view(capsys, tmp_path):
    words = ("--duration", "0.1", "--out", tmp_path / "run")
    call("gaze", *words, "--plant", "tests.envs.robot:Robot", "--point", 0, 0, -1000)
    assert "target: expected" not in capsys.readouterr().err


def gaze_of(name, tmp_path):
    path = tmp_path / f"{name}.toml"
    path.write_text(text_of(name))
    config = GazeConfig(head=str(path), plant="kinematic", target_mm=(50.0, 0.0, 800.0))
    return run_gaze(config)


def test_a_head_of_another_form_is_told_by_its_joints_actuators_and_residual(capsys, tmp_path):
    show(gaze_of("mis", tmp_path))
    out = capsys.readouterr().out
    assert out.startswith(
        "head mis: joints left_tilt, left_pan, right_tilt, right_pan; actuators tilt "
        "(left_tilt + right_tilt), left_pan (left_pan), right_pan (right_pan)\n"
        "the two eyes cannot both look exactly at the target"
    )
    assert re.search(r"least error that the actuators allow is 0\.\d+ px", out)
    assert re.search(r"within 1 px of it after 0\.\d+ s", out)


def test_eyes_whose_axes_never_cross_have_not_settled(capsys, tmp_path):
    gaze = gaze_of("common", tmp_path)
    show(gaze)
    out = capsys.readouterr().out
    assert "the two eyes cannot both look at the target" in out
    assert "settled to 1 px" not in out
    assert not gaze.gaze_fix.valid[0]
    assert verdict(gaze) == 0
    assert "no joint turns one eye alone" in capsys.readouterr().err
    unknown = np.full(3, np.nan)  # as on a robot
    assert verdict(replace(gaze, true_target_m=unknown, residual=np.full((2, 2), np.nan))) == 0


def test_the_article_s_heads_are_told_as_ever(capsys, result):
    show(result)
    out = capsys.readouterr().out
    assert out.startswith("settled to 1 px after")
    assert "joints" not in out.partition("\n")[0]
