"""A motion's row, and paths: where a target is after each jump and knot, and when it shows."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vergence.envs.targets.motion import (
    is_shown,
    last_jump_time,
    motion_rows,
    point_at,
    target_position,
)

FIRST, SECOND, BEFORE = (0.0, -0.1, 1.0), (0.2, 0.0, 0.8), (-0.1, 0.1, 1.2)


def shown(row, times: list[float]) -> list[bool]:
    return [is_shown(row, t) for t in times]


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


EYE = np.array([0.02, -0.1, 0.05])
SPEED = 0.6
TIMES = np.array([0.0, 0.4, 0.6, 1.1])
END = TIMES[-1]


def path_of(seed: int) -> np.ndarray:
    """Four knots, each as far round the eye from the last as the speed takes it."""
    rng = np.random.default_rng(seed)
    sight, knots = np.array([0.0, 0.0, 1.0]), []
    for k, t in enumerate(TIMES):
        if k:
            aside = np.cross(sight, rng.normal(size=3))
            aside /= np.linalg.norm(aside)
            turn = SPEED * (t - TIMES[k - 1])
            sight = np.cos(turn) * sight + np.sin(turn) * aside
        knots.append([t, *(EYE + sight / rng.uniform(0.4, 2.5))])
    return np.array([SPEED, *EYE, *np.ravel(knots)])


PATHS = st.builds(path_of, st.integers(0, 2**32 - 1))


@given(PATHS)
def test_a_path_is_at_each_knot_in_its_time(path) -> None:
    for t, *point in path.reshape(-1, 4)[1:]:
        assert point_at(path, t) == pytest.approx(point, abs=1e-12)


@given(PATHS, st.integers(0, 2), st.floats(0.0, 0.95))
def test_between_knots_sight_turns_and_nearness_changes_at_constant_rates(path, k, share) -> None:
    span = TIMES[k + 1] - TIMES[k]
    t = TIMES[k] + span * np.array([share, share + 0.02, share + 0.04])
    sight = np.array([point_at(path, one) for one in t]) - EYE
    distance = np.linalg.norm(sight, axis=-1)
    sight /= distance[:, None]
    turned = 2.0 * np.arcsin(0.5 * np.linalg.norm(np.diff(sight, axis=0), axis=-1))
    assert turned == pytest.approx(SPEED * 0.02 * span, rel=1e-9)
    # on a great circle: the three directions lie in a plane
    assert np.linalg.det(sight) == pytest.approx(0.0, abs=1e-14)
    ends = 1.0 / np.linalg.norm(path.reshape(-1, 4)[k + 1 : k + 3, 1:] - EYE, axis=-1)
    assert np.diff(1.0 / distance) == pytest.approx(0.02 * (ends[1] - ends[0]), abs=1e-12)


@given(PATHS, st.floats(0.0, END))
def test_after_its_end_a_path_leads_back_and_forth_again(path, s) -> None:
    for there in (2.0 * END - s, 2.0 * END + s, 1000.0 * END - s):
        # a time of a thousand ends is rounded by 1e-13 of itself
        assert point_at(path, there) == pytest.approx(point_at(path, s), abs=1e-10)


def test_a_target_stands_still_until_its_path_begins() -> None:
    path = path_of(0)
    beginning = path[5:8]
    rows = motion_rows(beginning, before=beginning[None], path=path[None])
    assert np.array_equal(target_position(rows[0], [-5.0, -1e-9]), [beginning, beginning])
    assert target_position(rows[0], 0.5) == pytest.approx(point_at(path, 0.5), abs=1e-15)
