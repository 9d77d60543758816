"""`vergence gaze` as a person reads it."""

import re
from dataclasses import replace

import numpy as np
import pytest

from vergence.commands.gaze import _print_gaze as show
from vergence.eval.gaze import run_gaze
from vergence.eval.gaze_config import GazeConfig


@pytest.fixture(scope="module")
def result():
    return run_gaze(GazeConfig(duration_s=0.2))


@pytest.mark.parametrize("columns", [40, 60, 80])
def test_the_table_explains_its_methods_and_cuts_no_number(capsys, monkeypatch, result, columns):
    monkeypatch.setenv("COLUMNS", str(columns))
    show(result)
    out = capsys.readouterr().out
    said = " ".join(out.split())
    assert "gaze: where the optical axes cross, from the joint angles alone" in said
    assert "ITPC (integrated two-pose calibration): where the rays through" in said
    assert "…" not in out
    for fix in (result.gaze, result.itpc):
        for value in (*fix.point[0], *fix.sigma[0]):
            assert re.search(rf"(?<![\d.]){re.escape(f'{1e3 * value:z.3f}')}(?!\d)", out)


def test_what_rounds_to_zero_is_printed_without_a_sign(capsys, result):
    point = result.truth_m + np.array([-1e-9, 1e-9, -1e-8])
    fix = result.gaze._replace(point=point[None], gap=np.array([-0.0]))
    exact = replace(
        result, gaze=fix, itpc=fix, truth_m=np.where(result.truth_m, result.truth_m, -0.0)
    )
    show(exact)
    assert not re.search(r"[-+]0\.0+(?!\d)", capsys.readouterr().out)
