"""Paths: at each knot in time, at one angular speed between, and back where they end."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vergence.envs.targets.motion import motion_rows, point_at, target_position

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
