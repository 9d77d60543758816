"""Wandering and occluded targets: as fast as drawn, within reach, never where one would expect."""

import numpy as np
import pytest

from tests.envs.trials import Array, assert_uniform, draw, eccentricity, midpoint_between_eyes
from tests.heads import MOVING, text_of
from tests.naming import named
from vergence import HeadModel
from vergence.envs.plant import make_plant
from vergence.envs.targets.motion import (
    MOTION,
    is_detectable_by_both_eyes,
    is_shown,
    motion_fields,
    target_position,
)
from vergence.envs.targets.pursuit import WanderTarget
from vergence.errors import ConfigurationError
from vergence.models import parse_head

DEGREE = np.pi / 180


def knots(rows: Array) -> Array:
    """(n, k, 4) the corners: seconds, and metres in N."""
    return rows[:, MOTION + 4 :].reshape(len(rows), -1, 4)


def sight(head: HeadModel, points: Array) -> tuple[Array, Array]:
    """(..., 3) directions seen from between the eyes, and (...) 1 / distance, 1/m."""
    seen = points - midpoint_between_eyes(head)
    distance = np.linalg.norm(seen, axis=-1)
    return seen / distance[..., None], 1.0 / distance


def test_between_turns_its_angular_speed_is_the_trials(simulated: HeadModel) -> None:
    target = WanderTarget()
    rows, _q = draw(simulated, target, 100)
    corners = knots(rows)[..., 0]
    begin, span = corners[:, :-1], np.diff(corners, axis=1)
    speeds = []
    for share in np.linspace(0.0, 0.9, 10):
        t = begin + share * span
        now, near = sight(simulated, target_position(rows[:, None], t))
        then, later = sight(simulated, target_position(rows[:, None], t + 0.1 * span))
        turned = 2.0 * np.arcsin(0.5 * np.linalg.norm(then - now, axis=-1))
        speeds.append(turned / (0.1 * span))
        assert (np.abs(later - near) / (0.1 * span) <= target.approach + 1e-9).all()
    speed = np.array(speeds)
    assert np.ptp(speed, axis=(0, 2)) == pytest.approx(0.0, abs=1e-9)
    drawn = speed[0, :, 0]
    low, high = 5 * DEGREE, 40 * DEGREE
    assert drawn == pytest.approx(rows[:, MOTION])
    assert_uniform((drawn - low) / (high - low))


def test_it_turns_at_drawn_times_into_any_direction(simulated: HeadModel) -> None:
    # a small part of a large workspace, where no stretch is refused
    target = {"kind": "wander", "speed": (0.05, 0.1), "approach": 0.05, "eccentricity": 0.8}
    rows, _q = draw(simulated, target, 300)
    corners = knots(rows)
    inner = (np.abs(corners[..., 3] - 1.0) < 0.3).all(axis=1)
    inner &= (eccentricity(simulated, corners[..., 1:]) < 0.3).all(axis=1)
    assert inner.sum() > 20
    spans = np.diff(corners[inner, :, 0], axis=1)
    assert_uniform((spans.ravel() - 0.15) / 0.35)
    way = np.diff(sight(simulated, corners[inner][..., 1:])[0][..., :2], axis=1)
    heading = np.arctan2(way[..., 1], way[..., 0])
    bend = (np.diff(heading, axis=1).ravel() / (2 * np.pi)) % 1.0
    # foreshortened by up to 5 % at the side of the view, which is too little to tell
    assert_uniform(bend)


def test_it_never_leaves_where_both_eyes_can_fixate_it(head: HeadModel) -> None:
    target = WanderTarget()
    rows, q = draw(head, target, 30)
    points = target_position(rows[:, None], np.linspace(0.0, 30.0, 901))
    # stretches are tried at steps of up to 5 degrees, between which they bulge a little
    assert points[..., 2].min() >= 0.4 * 0.998
    assert points[..., 2].max() <= 2.5 * 1.002
    assert eccentricity(head, points).max() <= target.eccentricity + 1e-3
    angles = head.fixate(points)
    assert head.limits.contains(angles, 1.9 * DEGREE).all()
    # the eyes hold it where it stands until time zero
    assert target_position(rows, -1.0) == pytest.approx(points[:, 0], abs=1e-12)
    assert np.abs(angles[:, 0] - q).max() < 1e-9
    # near and far, and to all sides
    assert np.ptp(points[..., 2], axis=1).max() > 0.5
    assert np.quantile(np.ptp(points[..., 0], axis=1), 0.2) > 0.1


@pytest.mark.slow
def test_following_it_takes_half_of_the_actuators_speed() -> None:
    for shape in MOVING:
        with named(shape):
            # slow ones, whose speed decides which stretches are fit
            slow = text_of(shape).replace("velocity_rad_s = 5.0", "velocity_rad_s = 1.2")
            head = parse_head(slow)
            own = head.actuation
            rows, _q = draw(head, "wander", 6)
            t = np.linspace(0.0, 8.0, 1921)
            angles = own.actuators_of(head.fixate(target_position(rows[:, None], t)))
            rates = np.abs(np.diff(angles, axis=1)) / (t[1] - t[0])
            eyes = slice(3, 3 + own.count)
            # stretches are tried at steps of 5 degrees; between, a rate can be a little higher
            assert (rates[..., eyes] <= 0.53 * own.velocity[eyes]).all()
            assert rates[..., eyes].max() > 0.3 * own.velocity[eyes].max()


def test_it_never_ends(simulated: HeadModel) -> None:
    rows, _q = draw(simulated, "wander", 20)
    end = knots(rows)[:, -1, 0]
    assert (end >= 32 * 0.15).all()
    for t in (0.3, 1.7):
        before, after = target_position(rows, end - t), target_position(rows, end + t)
        assert after == pytest.approx(before, abs=1e-9)
    assert np.isfinite(target_position(rows, 1e5)).all()
    late = target_position(rows[:, None], 1e5 + np.linspace(0.0, 0.1, 3))
    assert (np.linalg.norm(np.diff(late, axis=1), axis=-1) > 0.0).all()


@pytest.mark.slow
def test_the_whole_board_is_seen_all_the_way(simulated: HeadModel) -> None:
    board = make_plant("rendered", simulated, 1, width_rad="fit").board
    rows, _q = draw(simulated, "wander", 3, board=board)
    corners = knots(rows)[..., 0]
    t = np.concatenate([corners, 0.5 * (corners[:, 1:] + corners[:, :-1])], axis=1)
    points = target_position(rows[:, None], t).reshape(-1, 3)
    angles = simulated.fixate(points)[:, 3:]
    for q, point in zip(angles, points, strict=True):
        assert is_detectable_by_both_eyes(simulated.packed, q, tuple(point), 0.0, board)


def test_a_head_that_is_too_slow_for_it_is_told_so(simulated: HeadModel) -> None:
    with pytest.raises(ConfigurationError, match="paths that this head can follow and see, got"):
        draw(simulated, {"kind": "wander", "speed": (5.0, 6.0), "turn_after": (0.1, 0.2)})


def test_it_runs_the_ellipse_of_an_orbit(simulated: HeadModel) -> None:
    rows, q = draw(simulated, "occluded", 20)
    orbits, start = draw(simulated, "orbit", 20)
    t = np.linspace(-0.1, 4.0, 83)
    assert np.array_equal(target_position(rows[:, None], t), target_position(orbits[:, None], t))
    assert np.array_equal(q, start)


def test_it_is_gone_for_as_long_as_said_from_a_drawn_moment_on(simulated: HeadModel) -> None:
    rows, _q = draw(simulated, {"kind": "occluded", "gone_after": (0.5, 2.0), "gone_s": 0.4}, 1000)
    gone, back = motion_fields(rows)["hidden_from"], motion_fields(rows)["hidden_until"]
    assert_uniform((gone - 0.5) / 1.5)
    assert np.array_equal(back, gone + 0.4)
    for n in range(20):
        for t in (-1.0, 0.0, np.nextafter(gone[n], 0.0), back[n], 100.0):
            assert is_shown(rows[n], t)
        for t in (gone[n], 0.5 * (gone[n] + back[n]), np.nextafter(back[n], 0.0)):
            assert not is_shown(rows[n], t)


def test_it_comes_back_elsewhere(simulated: HeadModel) -> None:
    rows, _q = draw(simulated, "occluded", 200)
    fields = motion_fields(rows)
    ends = [target_position(rows, fields[end]) for end in ("hidden_from", "hidden_until")]
    moved = ends[1] - ends[0]
    # a slow flat ellipse can be back where it went; nearly all are centimetres away
    assert np.quantile(np.linalg.norm(moved, axis=-1), 0.05) > 0.01
