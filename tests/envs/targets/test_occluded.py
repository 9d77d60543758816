"""Occluded targets: the same ellipse, gone for a while."""

import numpy as np

from tests.envs.drawn import draw
from tests.envs.trials import assert_uniform
from vergence import HeadModel
from vergence.envs.targets.motion import (
    HIDDEN_FROM,
    HIDDEN_UNTIL,
    is_shown,
    target_position,
    unpack_motion,
)


def test_it_runs_the_ellipse_of_an_orbit(simulated: HeadModel) -> None:
    rows, q = draw(simulated, "occluded", 20)
    orbits, start = draw(simulated, "orbit", 20)
    t = np.linspace(-0.1, 4.0, 83)
    assert np.array_equal(target_position(rows[:, None], t), target_position(orbits[:, None], t))
    assert np.array_equal(q, start)


def test_it_is_gone_for_as_long_as_said_from_a_drawn_moment_on(simulated: HeadModel) -> None:
    rows, _q = draw(simulated, {"kind": "occluded", "gone_after": (0.5, 2.0), "gone_s": 0.4}, 1000)
    gone, back = rows[:, HIDDEN_FROM], rows[:, HIDDEN_UNTIL]
    assert_uniform((gone - 0.5) / 1.5)
    assert np.array_equal(back, gone + 0.4)
    for n in range(20):
        motion = unpack_motion(rows[n])
        for t in (-1.0, 0.0, np.nextafter(gone[n], 0.0), back[n], 100.0):
            assert is_shown(motion, t)
        for t in (gone[n], 0.5 * (gone[n] + back[n]), np.nextafter(back[n], 0.0)):
            assert not is_shown(motion, t)


def test_it_comes_back_elsewhere(simulated: HeadModel) -> None:
    rows, _q = draw(simulated, "occluded", 200)
    ends = [target_position(rows, rows[:, end]) for end in (HIDDEN_FROM, HIDDEN_UNTIL)]
    moved = ends[1] - ends[0]
    # a slow flat ellipse can be back where it went; nearly all are centimetres away
    assert np.quantile(np.linalg.norm(moved, axis=-1), 0.05) > 0.01
