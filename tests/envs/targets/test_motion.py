"""A motion's row: where a target is after each jump, and when there is anything to see."""

import numpy as np
import pytest

from vergence.envs.targets.motion import (
    is_shown,
    last_jump_time,
    motion_rows,
    target_position,
    unpack_motion,
)

FIRST, SECOND, BEFORE = (0.0, -0.1, 1.0), (0.2, 0.0, 0.8), (-0.1, 0.1, 1.2)


def shown(row, times: list[float]) -> list[bool]:
    return [is_shown(unpack_motion(row), t) for t in times]


def test_a_target_jumps_a_second_time_exactly_when_said() -> None:
    rows = motion_rows([FIRST], before=[BEFORE], second_jump_time=0.15, second_anchor=[SECOND])
    for t, expected in ((-1e-9, BEFORE), (0.0, FIRST), (0.15 - 1e-9, FIRST), (0.15, SECOND)):
        assert np.array_equal(target_position(rows[0], t), expected)
    assert np.array_equal(target_position(rows[0], 1e6), SECOND)


def test_a_moving_target_goes_on_after_its_second_jump() -> None:
    circle = {"cosine": (0.1, 0.0, 0.0), "sine": (0.0, 0.1, 0.0), "omega": 2.0}
    line = {"velocity": (0.3, 0.0, 0.0), "duration": 2.0}
    for motion in (circle, line):
        once = motion_rows([FIRST], **motion)
        twice = motion_rows([FIRST], **motion, second_jump_time=0.5, second_anchor=[SECOND])
        t = np.linspace(0.0, 4.0, 41)
        moved = target_position(twice[0], t) - target_position(once[0], t)
        expected = np.where(t[:, None] < 0.5, 0.0, np.subtract(SECOND, FIRST))
        assert moved == pytest.approx(expected, abs=1e-15)


def test_the_last_jump_is_the_second_where_there_is_one() -> None:
    rows = np.concatenate(
        [
            motion_rows([FIRST]),
            motion_rows([FIRST], jump_time=0.1),
            motion_rows([FIRST], second_jump_time=0.15, second_anchor=[SECOND]),
        ]
    )
    assert np.array_equal(last_jump_time(rows), [0.0, 0.1, 0.15])
    assert last_jump_time(rows[2]) == 0.15
    t = last_jump_time(rows) + np.array([[0.0], [1.0], [100.0]])
    assert (np.ptp(target_position(rows, t), axis=0) == 0.0).all()


def test_a_target_that_was_not_there_is_shown_from_its_jump_on() -> None:
    appears, jumps = motion_rows([FIRST]), motion_rows([FIRST], before=[BEFORE])
    times = [-1.0, -1e-9, 0.0, 100.0]
    assert shown(appears[0], times) == [False, False, True, True]
    assert shown(jumps[0], times) == [True] * 4


def test_a_hidden_target_is_gone_from_the_first_moment_and_back_at_the_last() -> None:
    rows = motion_rows([FIRST], hidden_from=1.0, hidden_until=1.3)
    times = [0.0, np.nextafter(1.0, 0), 1.0, np.nextafter(1.3, 0), 1.3, 100.0]
    assert shown(rows[0], times) == [True, True, False, False, True, True]
    for_ever = motion_rows([FIRST], hidden_from=1.0)
    assert shown(for_ever[0], [0.9, 1.0, 1e9]) == [True, False, False]
