"""Fuzzy PID: the rule base, the inference, and the law with its gains."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.controllers.loops import true_errors
from vergence import load_head, make_controller
from vergence.controllers.pid import FUZZY_SETS, RULES, rule_base
from vergence.envs.task import GazeTask

HEAD = load_head("simulated")
SPANS = {"span_p": 1.0, "span_i": 1.0, "span_d": 1.0, "error_px": 90.0, "rate_px_s": 900.0}
FUZZY = make_controller("fuzzy", head=HEAD, **SPANS)
errors = st.floats(-200.0, 200.0)
rates = st.floats(-2000.0, 2000.0)


def memberships(x: float) -> np.ndarray:
    """(7,) triangles over [-1, 1], written out."""
    centres = np.linspace(-1.0, 1.0, 7)
    return np.maximum(0.0, 1.0 - np.abs(np.clip(x, -1.0, 1.0) - centres) * 3.0)


@given(error=errors, rate=rates)
def test_the_inference_is_the_weighted_average_of_all_49_rules(error, rate) -> None:
    weights = np.outer(memberships(error / 90.0), memberships(rate / 900.0))
    expected = 1.0 + (weights * rule_base()).sum(axis=(1, 2)) / weights.sum()
    assert FUZZY.factors(error, rate) == pytest.approx(expected, abs=1e-12)


def test_the_rules_in_words_are_those_that_fire() -> None:
    for gain, rows in enumerate(RULES.values()):
        for row, text in zip(("ZO", "PS", "PM", "PB"), rows, strict=True):
            error = 90.0 * (FUZZY_SETS.index(row) - 3) / 3.0
            for column, word in enumerate(text.split()):
                factor = FUZZY.factors(error, 900.0 * (column - 3) / 3.0)[gain]
                assert factor == pytest.approx(1.0 + (FUZZY_SETS.index(word) - 3) / 3.0)


def test_coming_in_fast_close_to_the_target_brakes_and_far_away_nothing_is_integrated() -> None:
    coming, going = FUZZY.factors(30.0, -600.0), FUZZY.factors(30.0, 600.0)
    assert coming[0] < 1.0 < going[0]
    assert going[2] < 1.0 < coming[2]
    assert FUZZY.factors(90.0, 0.0)[1] == 0.0
    assert FUZZY.factors(0.0, 0.0)[1] == 2.0


def test_without_spans_it_is_the_pid() -> None:
    gains = {"kp": 5.0, "ki": 0.7, "kd": 0.2, "filter_s": 0.01}
    pid = make_controller("pid", head=HEAD, **gains)
    fuzzy = make_controller("fuzzy", head=HEAD, **gains, span_p=0.0, span_i=0.0, span_d=0.0)
    task = GazeTask(8, head=HEAD, plant="kinematic")
    assert true_errors(task, fuzzy, 0.5) == pytest.approx(true_errors(task, pid, 0.5), abs=1e-4)
