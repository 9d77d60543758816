"""Targets: how each kind moves, what random ones promise, what is refused."""

import numpy as np
import pytest

from tests.envs.trials import assert_uniform, draw
from tests.naming import named, refused
from vergence import HeadModel
from vergence.envs.gaze import GazeEnv
from vergence.envs.targets import make_target
from vergence.envs.targets.motion import motion_fields, target_position
from vergence.envs.targets.workspace import RandomTarget
from vergence.errors import UnknownNameError


def test_a_static_target_rests_and_was_not_there_before(simulated: HeadModel) -> None:
    rows, q = draw(simulated, {"kind": "static", "point": [0.1, -0.2, 0.8]})
    for t in (0.0, 0.5, 100.0):
        assert target_position(rows[0], t) == pytest.approx([0.1, -0.2, 0.8], abs=1e-15)
    assert motion_fields(rows)["seen_before"][0] == 0.0
    assert np.array_equal(q[0], simulated.rest())


def test_a_step_target_jumps_at_time_zero(simulated: HeadModel) -> None:
    before, after = (0.0, -0.1, 1.0), (0.1, -0.2, 0.9)
    rows, q = draw(simulated, {"kind": "step", "before": before, "after": after})
    assert target_position(rows[0], -1e-9) == pytest.approx(before, abs=1e-15)
    assert target_position(rows[0], 0.0) == pytest.approx(after, abs=1e-15)
    assert motion_fields(rows)["seen_before"][0] == 1.0
    # the eyes hold it until then
    error = simulated.project(q[0], before) - simulated.cameras.principal
    assert np.abs(error).max() < 1e-9


def test_a_circle_is_the_articles_trajectory(simulated: HeadModel) -> None:
    target = {"kind": "circle", "centre": (0.0, -0.1, 1.0), "radius": 0.1, "period": 8.0}
    rows, q = draw(simulated, target)
    t = np.linspace(0.0, 16.0, 50)
    phase = 2 * np.pi * t / 8.0
    expected = np.stack([0.1 * np.sin(phase), -0.1 + 0.1 * np.cos(phase), np.ones(50)], axis=-1)
    assert target_position(rows[0], t) == pytest.approx(expected, abs=1e-14)
    # it stands at its beginning until time zero, and the eyes hold it there
    assert target_position(rows[0], -3.0) == pytest.approx(expected[0], abs=1e-15)
    assert np.array_equal(q[0], simulated.fixate(expected[0]))


def test_the_default_circle_turns_once_in_62_8_seconds(simulated: HeadModel) -> None:
    # "t / 10000" of the article, t in milliseconds
    rows, _q = draw(simulated, "circle")
    t = 7.0
    expected = [0.1 * np.sin(t / 10), -0.1 + 0.1 * np.cos(t / 10), 1.0]
    assert target_position(rows[0], t) == pytest.approx(expected, abs=1e-14)


def test_a_line_is_followed_at_its_speed_and_ends(simulated: HeadModel) -> None:
    origin, end = np.array([-0.1, 0.0, 1.0]), np.array([0.2, 0.0, 1.4])  # half a metre
    rows, _q = draw(simulated, {"kind": "line", "origin": origin, "end": list(end), "speed": 0.25})
    for t, share in ((-1.0, 0.0), (0.0, 0.0), (0.5, 0.25), (2.0, 1.0), (5.0, 1.0)):
        expected = origin + share * (end - origin)
        assert target_position(rows[0], t) == pytest.approx(expected, abs=1e-14)


def test_a_line_without_length_is_a_point_at_rest(simulated: HeadModel) -> None:
    point = (0.0, -0.1, 1.0)
    rows, _q = draw(simulated, {"kind": "line", "origin": point, "end": point})
    assert target_position(rows[0], [0.0, 3.0]) == pytest.approx(np.array([point, point]))


def test_random_targets_keep_their_promises(head: HeadModel) -> None:
    for start in ["fixation", "rest"]:
        with named(start):
            target = RandomTarget(start=start)
            rows, q = draw(head, target, 600)
            points = target_position(rows, 0.0)
            fixating = head.fixate(points)
            assert head.limits.contains(fixating, target.margin).all()
            assert head.limits.contains(q, target.margin).all()
            turn = (fixating - q)[:, 3:].reshape(-1, 2, 2)
            assert (np.linalg.norm(turn, axis=-1).max(axis=1) >= target.shift).all()
            pixels = head.project(q, points)
            size = head.cameras.size
            assert ((pixels >= 0) & (pixels <= size - 1)).all()
            assert (points[:, 2] >= 0.3).all()
            assert (points[:, 2] <= 2.5).all()
            middle = head.camera_poses(head.rest())[:, :3, 3].mean(axis=0)
            aside = np.hypot(*(points - middle)[:, :2].T) / points[:, 2]
            assert (np.arctan(aside) <= target.eccentricity + 1e-12).all()
            # the start is another point that the eyes hold, or rest
            assert (np.abs(q[:, 3:]).max(axis=1) > 0).all() == (start == "fixation")


def test_random_targets_are_uniform_in_eccentricity_and_inverse_depth(head: HeadModel) -> None:
    # a small workspace, in which nothing is rejected for the eyes' sake
    target = {"kind": "random", "depth": [0.5, 2.0], "eccentricity": 0.25, "shift": 0.0}
    rows, _q = draw(head, target, 1500)
    points = target_position(rows, 0.0)
    middle = head.camera_poses(head.rest())[:, :3, 3].mean(axis=0)
    across = (points - middle)[:, :2]
    inverse = (1 / points[:, 2] - 1 / 2.0) / (1 / 0.5 - 1 / 2.0)
    aside = np.arctan(np.hypot(*across.T) / points[:, 2]) / 0.25
    around = (np.arctan2(across[:, 1], across[:, 0]) / (2 * np.pi)) % 1.0
    for sample in (inverse, aside, around):
        assert_uniform(sample)


def test_a_trial_draws_the_same_target_alone_and_in_a_batch(simulated: HeadModel) -> None:
    for kind in ["random", "double-step", "orbit", "occluded", "wander"]:
        with named(kind):
            rows, q = draw(simulated, kind, 20)
            for trial in (0, 7, 19):
                row, start = draw(simulated, kind, first=trial)
                assert np.array_equal(row[0], rows[trial])
                assert np.array_equal(start[0], q[trial])


def test_a_workspace_that_nothing_can_look_at_is_refused(simulated: HeadModel) -> None:
    # a hand's breadth from the nose both eyes would have to turn in by more than they can
    target = {"kind": "random", "depth": (0.04, 0.041), "eccentricity": 0.01}
    refused("workspace that this head can look at", draw, simulated, target)


def test_a_start_that_cannot_be_fixated_is_refused(simulated: HeadModel) -> None:
    target = {"kind": "static", "point": (5.0, 0.0, 0.5), "start": "fixation"}
    refused("start that both eyes can fixate", draw, simulated, target)


def test_an_unknown_kind_is_refused_with_the_known_ones() -> None:
    for kind in ["nowhere", None, 5, ["static"]]:
        with named(kind):
            kinds = "circle, double-step, line, occluded, orbit, random, static, step, wander"
            with pytest.raises(UnknownNameError, match=kinds) as caught:
                make_target({"kind": kind})
            assert repr(kind) in str(caught.value)


def test_an_unknown_field_is_refused_with_its_value() -> None:
    refused(r"target\.pont.*point, start.*'pont' = 3", make_target, {"kind": "static", "pont": 3})


def test_a_value_that_cannot_be_is_refused_by_key_and_value() -> None:
    for fields, key, value in [
        ({"kind": "static", "point": [1, 2]}, "point", r"\[1, 2\]"),
        ({"kind": "static", "point": "far"}, "point", "'far'"),
        ({"kind": "static", "point": [0, 0, np.nan]}, "point", "nan"),
        ({"kind": "static", "start": "asleep"}, "start", "'asleep'"),
        ({"kind": "circle", "radius": -0.1}, "radius", "-0.1"),
        ({"kind": "circle", "period": 0}, "period", "0"),
        ({"kind": "line", "speed": 0.0}, "speed", "0.0"),
        ({"kind": "random", "depth": [2.0, 1.0]}, "depth", r"\(2.0, 1.0\)"),
        ({"kind": "random", "eccentricity": 2.0}, "eccentricity", "2.0"),
        ({"kind": "random", "shift": np.inf}, "shift", "inf"),
        ({"kind": "double-step", "second_after": (0.0, 0.2)}, "second_after", r"\(0.0, 0.2\)"),
        ({"kind": "occluded", "gone_after": [2.0, 1.0]}, "gone_after", r"\(2.0, 1.0\)"),
        ({"kind": "occluded", "gone_s": 0.0}, "gone_s", "0.0"),
        ({"kind": "wander", "speed": 0.5}, "speed", "0.5"),
        ({"kind": "wander", "turn_after": (0.5, 0.15)}, "turn_after", r"\(0.5, 0.15\)"),
    ]:
        said = rf"target\.{key}: expected .*{value}"
        refused(said, make_target, fields)


MM = {
    "static": {"point": [0, -100, 1000]}, "step": {"after": [0, -200, 1000]},
    "circle": {"radius": 100}, "line": {"end": [-390.02, -30.39, 1111.91]},
    "random": {"depth": (300, 2500)}, "double-step": {"depth": (300, 2500)},
    "orbit": {"depth": (400, 2500)}, "occluded": {"depth": (400, 2500)},
    "wander": {"depth": (400, 2500)},
}  # fmt: skip


def test_millimetres_are_refused_with_a_hint() -> None:
    hint = r"metres below 100 .*is it in millimetres\?"
    for kind in MM:
        refused(hint, make_target, {"kind": kind, **MM[kind]})


def test_a_target_that_no_eye_can_find_or_reach_is_refused() -> None:
    for target, message in [
        ({"kind": "static", "point": (0.1, 0.0, -1.0)}, "behind the head"),
        ({"kind": "static", "point": (5.0, 0.0, 0.5)}, "outside both images"),
        ({"kind": "static", "point": (0.0, 1.2, 0.5), "start": "fixation"}, "can fixate"),
        ({"kind": "step", "after": (0.0, 0.0, -1.0)}, "behind the head"),
        ({"kind": "step", "before": (5.0, 0.0, 0.5)}, "can fixate"),
        ({"kind": "circle", "centre": (0.0, 0.0, -1.0)}, "can fixate"),
        ({"kind": "line", "origin": (3.0, 0.0, 0.5), "start": "rest"}, "outside both images"),
    ]:
        refused(message, GazeEnv, plant="kinematic", target=target)


def test_a_target_that_one_eye_sees_is_there_to_be_found() -> None:
    target = {"kind": "static", "point": (0.4, 0.0, 0.5)}
    env = GazeEnv(plant="kinematic", target=target, info=("truth",))
    _observation, info = env.reset(seed=0)
    assert info["truth"]["image_visible"].tolist() == [False, True]


def test_a_target_that_begins_in_view_may_leave_it() -> None:
    line = {"kind": "line", "origin": (0.0, -0.1, 1.0), "end": (5.0, -0.1, 0.2), "speed": 2.0}
    GazeEnv(plant="kinematic", target=line).close()
