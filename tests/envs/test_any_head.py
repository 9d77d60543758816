"""The gaze task of heads that are not the article's: ties, missing joints, pan before tilt."""

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from tests.envs.any_head import begun, least_squares, uneven
from tests.heads import MOVING, head_of, text_of
from tests.naming import named, refused
from vergence.envs.reward import reducible_error
from vergence.envs.task import GazeTask
from vergence.errors import ConfigurationError
from vergence.models import parse_head
from vergence.viewer.eye_pictures import EYE_WIDTH
from vergence.viewer.pictures import VIEW_HEIGHT

TIED = tuple(name for name in MOVING if not head_of(name).actuation.direct)


def test_gymnasiums_checker_finds_nothing_wrong() -> None:
    for name in MOVING:
        with named(name):
            head = head_of(name)
            env = gymnasium.make("vergence/Gaze-v0", head=head, plant="kinematic")
            assert env.action_space.shape == (head.actuation.count,)
            assert env.observation_space.shape == (11 + 4 * head.actuation.count,)
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                check_env(env.unwrapped, skip_render_check=True)


@pytest.mark.parametrize(
    ("name", "target"),
    list(zip(MOVING, ["random", "double-step", "orbit", "random", "wander"], strict=True)),
)
def test_trials_ask_for_what_the_actuators_reach(name, target) -> None:
    head = head_of(name)
    task = begun(head, 12, target=target)
    truth = task.truth()
    assert truth.image_visible.all()
    assert head.reaches(truth.positions).all()
    assert np.array_equal(truth.positions[:, :3], np.tile(head.rest()[:3], (12, 1)))
    goal = head.fixate(truth.target)
    assert head.reaches(goal, 0.0349).all()
    pixels = head.project(goal, truth.target)
    assert ((pixels >= -0.5) & (pixels <= head.cameras.size - 0.5)).all()
    if target in ("random", "double-step"):
        turn = (goal - truth.positions)[:, 3:].reshape(-1, 2, 2)
        assert (np.linalg.norm(turn, axis=-1).max(axis=-1) >= 0.0349).all()


def test_an_orbit_asks_for_half_of_what_the_actuators_can_do() -> None:
    for name in MOVING:
        with named(name):
            head = head_of(name)
            own = head.actuation
            task = begun(head, 4, target="orbit")
            path = []
            for _ in range(240):
                task.step(np.zeros((4, own.count)))
                path.append(task.truth().target)
            angles = own.actuators_of(head.fixate(np.array(path)))[..., 3 : 3 + own.count]
            rates = np.abs(np.diff(angles, axis=0)) * head.timing.control_rate_hz
            # phases lie 2 pi / 48 apart, between which a rate can be a little higher
            assert (rates <= 0.53 * own.velocity[3 : 3 + own.count]).all()


@pytest.mark.slow
def test_least_squares_settle_on_the_least_error_and_that_is_a_success() -> None:
    for name in MOVING:
        with named(name):
            head = head_of(name)
            task = begun(head, 8)
            for _ in range(230):
                task.step(least_squares(task, 4.0))
            assert task.success.all()
            truth = task.truth()
            left = truth.pixel_error - head.least_error(truth.target)
            assert np.abs(left).max() < 1.0
            # what is left to do is a fraction of a pixel: precision is 1/3 at its best, 1/6 at 1 px
            assert (task._outcome.terms[:, 1] > 0.25).all()


def test_the_reducible_part_is_the_projection_on_what_the_actuators_can_do() -> None:
    for name in TIED:
        with named(name):
            head = head_of(name)
            point = np.array([0.03, -0.02, 0.7])
            q = head.fixate(point)
            error = head.least_error(point) + np.array([[3.0, -2.0], [1.0, 4.0]])
            depth = np.linalg.inv(head.camera_poses(q))[:, 2] @ [*point, 1.0]
            jacobian = head.image_jacobian(q, error + head.cameras.principal, depth)[..., 3:]
            by_actuator = jacobian.reshape(4, 4) @ head.actuation.to_joints
            expected = by_actuator @ np.linalg.pinv(by_actuator, rcond=1e-9) @ error.ravel()
            out = np.empty((2, 2))
            reducible_error(head.packed, q, error, True, True, out)
            # the depth is triangulated from the errors, so it differs a little
            assert out.ravel() == pytest.approx(expected, abs=0.3)
            reducible_error(head.packed, q, error, True, False, out)
            assert np.isnan(out[1]).all()
            assert np.isfinite(out[0]).all()


def test_an_action_of_another_length_is_refused_by_the_actuators_names() -> None:
    env = gymnasium.make("vergence/Gaze-v0", head=head_of("tied"), plant="kinematic").unwrapped
    env.reset(seed=0)
    said = r"\(1, 3\), heads by tilt, version, vergence, got"
    refused(said, env.step, np.zeros(4))


def test_a_fixed_pair_has_nothing_to_turn() -> None:
    for make in (gymnasium.make, gymnasium.make_vec):
        for plant in ("kinematic", "mujoco"):
            said = r"^.*a fixed pair.*triangulate_views.*$"
            refused(said, make, "vergence/Gaze-v0", head=head_of("pair"), plant=plant)


def test_a_fixed_pair_on_a_neck_is_told_how_its_neck_becomes_what_turns_the_eyes() -> None:
    neck = text_of("common").replace('part = "both"', 'part = "neck"')
    with pytest.raises(ConfigurationError, match=r"on a neck.*'both'.*leave out --neck"):
        gymnasium.make("vergence/Gaze-v0", head=parse_head(neck), plant="kinematic")
    turned = parse_head(neck.replace('part = "neck"', 'part = "both"'))
    gymnasium.make("vergence/Gaze-v0", head=turned, plant="kinematic").close()


def test_a_head_that_can_look_nowhere_in_the_workspace_is_told_so() -> None:
    head = head_of("common")
    limits = head.limits
    narrow = head.replace(limits={"lower": 0.01 * limits.lower, "upper": 0.01 * limits.upper})
    refused("expected a workspace that this head can look at", begun, narrow, 1)


def test_a_point_that_tied_eyes_cannot_look_at_is_refused() -> None:
    for name, point, said in [
        ("tied", (0.9, 0.0, 0.3), "look at within their limits"),
        # so near that the least error of eyes that look parallel is outside both images
        ("common", (0.0, -0.05, 0.08), "look at within their limits, and see then"),
    ]:
        with named(name, point, said):
            target = {"kind": "static", "point": point, "start": "fixation"}
            refused(said, GazeTask, head=head_of(name), plant="kinematic", target=target)


def test_eyes_with_images_of_different_sizes_settle_and_are_pictured() -> None:
    head = uneven("panfirst")
    task = begun(head, 6)
    wide = np.abs(task.observation[:, :4].reshape(6, 2, 2)).max()
    for _ in range(230):
        task.step(least_squares(task, 4.0))
    assert wide < 1.0
    assert task.success.all()
    env = gymnasium.make("vergence/Gaze-v0", head=head, plant="kinematic", render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()
    assert picture.shape[1] == 2 * EYE_WIDTH
    assert picture.shape[0] == 360 + VIEW_HEIGHT
