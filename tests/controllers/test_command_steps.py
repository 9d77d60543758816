"""Commands in steps: their mean is what was asked for, and one step alone is never sent."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vergence import load_head
from vergence.controllers.gate import CommandQuantiser

STEP = 0.024
LIMITS = np.full(4, 6.0)
HEAD = load_head("simulated").replace(sensor={"command_resolution_rad_s": STEP})


def sent(commands: np.ndarray) -> np.ndarray:
    """(steps, 4) what is sent of a series of commands."""
    steps, carried = CommandQuantiser(HEAD, LIMITS), np.zeros(4)
    return np.array([steps.quantise(command, carried) for command in commands])


@given(st.lists(st.floats(-5.9, 5.9), min_size=4, max_size=4))
def test_the_mean_is_the_command(command) -> None:
    found = sent(np.tile(command, (60, 1)))
    # at any time no more than a step and a half is missing
    missing = np.cumsum(found - np.array(command), axis=0)
    assert np.abs(missing).max() <= 1.5 * STEP + 1e-9


@given(st.lists(st.floats(-7.0, 7.0), min_size=4, max_size=4))
def test_all_that_is_sent_is_whole_steps_that_move_within_the_limits(command) -> None:
    counts = sent(np.tile(command, (20, 1))) / STEP
    assert counts == pytest.approx(np.rint(counts), abs=1e-9)
    assert not (np.abs(np.rint(counts)) == 1.0).any()
    assert np.abs(counts).max() <= 250.0 + 1e-9


def test_what_exceeds_the_limits_is_not_made_up_for_later() -> None:
    later = sent(np.repeat([[7.0] * 4, [2.0] * 4], [20, 5], axis=0))[20:]
    assert np.abs(np.cumsum(later - 2.0, axis=0)).max() <= 3.0 * STEP + 1e-9


def test_a_command_of_rest_rests_and_forgets() -> None:
    slow = np.full((1, 4), 0.6 * STEP)
    assert not sent(np.concatenate([slow, slow, np.zeros((5, 4)), slow, slow]))[2:].any()
    assert sent(np.concatenate([slow] * 3))[2] == pytest.approx(np.full(4, 2.0 * STEP))


def test_where_commands_have_no_steps_they_are_sent_as_they_are() -> None:
    steps, carried = CommandQuantiser(load_head("simulated"), LIMITS), np.zeros(4)
    command = np.array([0.001, -0.002, 3.0, 0.0])
    assert np.array_equal(steps.quantise(command, carried), command)
    assert not carried.any()
