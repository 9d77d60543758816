"""The predictor on heads of any shape: axes at any angle, joints tied or missing."""

import numpy as np
import pytest

from tests.controllers.loops import settle_time
from tests.controllers.reaching import run
from tests.heads import CENTRE, IMAGE, LOOP, eyes, head_of, joint
from vergence.controllers.prediction.delay import turn_of_axes
from vergence.controllers.prediction.joints import RIG, joint_rig
from vergence.controllers.prediction.virtual_joints import two_joints_an_eye
from vergence.envs.task import GazeTask
from vergence.models import parse_head
from vergence.models.fixation import fixate_eye
from vergence.models.kinematics import eye_frames
from vergence.models.pose import out_of

EXACT = {
    "detection_noise_px": 0.0,
    "encoder_resolution_rad": 0.0,
    "velocity_resolution_rad_s": 0.0,
}


def skewed():
    """A head whose axes are in no way at right angles; its eyes turn about their centres."""
    text = 'name = "skewed"\n'
    for eye, side in (("left", -1), ("right", 1)):
        text += joint(f"{eye}_one", eye, (side * 0.05, 0, 0), (0.9, 0.3 * side, 0.1))
        text += joint(f"{eye}_two", eye, CENTRE, (0.35, 0.9, -0.2 * side))
    return parse_head(text + IMAGE + eyes() + LOOP)


def goals_of(head, eye, q1, q2, ray, depth=0.8):
    """The angles that fixate a point that the eye, at some angles, sees at normalised (x, y)."""
    camera = eye_frames(head.packed, eye, q1, q2).camera
    point = out_of(camera, ray[0] * depth, ray[1] * depth, depth)
    return np.array(fixate_eye(head.packed, eye, *point))


@pytest.mark.parametrize("eye", [0, 1])
@pytest.mark.parametrize("ray", [(0.3, -0.2), (-0.25, 0.3)])
def test_goals_depend_on_the_second_angle_at_exposure_as_the_axes_say(eye, ray) -> None:
    head, q1, q2, h = skewed(), 0.15, -0.2, 1e-5
    first, second = goals_of(head, eye, q1, q2, ray)
    turn = turn_of_axes(first - q1, eye_frames(head.packed, eye, first, second))
    ahead, behind = (goals_of(head, eye, q1, q2 + s * h, ray) for s in (1, -1))
    assert turn == pytest.approx((ahead - behind) / (2 * h), abs=1e-6)
    # the first joint turns all behind it along
    ahead, behind = (goals_of(head, eye, q1 + s * h, q2, ray) for s in (1, -1))
    assert (ahead - behind) / (2 * h) == pytest.approx([1.0, 0.0], abs=1e-6)


@pytest.mark.parametrize("name", ["panfirst", "mis", "simulated"])
def test_at_right_angles_the_closed_form_is_the_same_whichever_joint_comes_first(name) -> None:
    from vergence import load_head

    head = load_head(name) if name == "simulated" else head_of(name)
    assert (joint_rig(head).view(RIG)["square"] == 1.0).all()
    left, goal = 0.3, np.array([0.2, -0.25])
    turn = turn_of_axes(left, eye_frames(head.packed, 0, *goal))
    expected = (np.tan(goal[1]) * np.sin(left), np.cos(left))
    # `mis` is a hundredth of a radian off
    assert turn == pytest.approx(expected, abs=1e-9 if name != "mis" else 0.01)
    assert (joint_rig(skewed()).view(RIG)["square"] == 0.0).all()


@pytest.mark.parametrize("head", [skewed(), head_of("panfirst"), head_of("tied"), head_of("mis")])
@pytest.mark.parametrize("delay", [4, 8, 13])
def test_one_saccade_tells_the_delay_on_any_head(head, delay) -> None:
    task = GazeTask(8, plant="kinematic", head=head, plant_options={"latency_s": delay / 120.0})
    trial = run(task, "saccade", 60)
    found = trial.predicted[-1].delay_s * head.timing.control_rate_hz
    np.testing.assert_allclose(found, delay, atol=1e-6)


@pytest.mark.parametrize("name", ["tied", "mis", "panfirst", "common", "vergeonly"])
def test_without_noise_the_prediction_is_the_truth_on_any_head(name) -> None:
    head = head_of(name).replace(sensor=EXACT)
    task = GazeTask(8, head=head, plant="kinematic")
    trial = run(task, "saccade", 60)
    predicted = np.array([p.pixel_error for p in trial.predicted])
    miss = np.linalg.norm(predicted[10:] - trial.errors[10:-1], axis=-1)
    # an image too fast for one eye has the depth of the one before, which moves a goal by as much;
    # a frame dated wrongly by one period would leave a hundred times that
    assert miss.max() < 0.2


@pytest.mark.parametrize("name", ["common", "vergeonly", "pair"])
def test_joints_made_up_for_an_eye_leave_the_cameras_where_they_are(name) -> None:
    head = head_of(name)
    q = np.zeros(7)
    q[3:] = np.where([bool(joint) for joint in head.joints[3:]], [0.2, -0.1, 0.2, -0.1], 0.0)
    packed = two_joints_an_eye(head)
    for eye in range(2):
        own = eye_frames(head.packed, eye, *q[3 + 2 * eye : 5 + 2 * eye]).camera
        assert eye_frames(packed, eye, *q[3 + 2 * eye : 5 + 2 * eye]).camera == pytest.approx(own)
        point = (0.1, 0.15, 0.9)
        assert np.isfinite(fixate_eye(packed, eye, *point)).all()


def test_each_actuator_is_followed_by_its_own_lag_and_encoder() -> None:
    lags = {"lag_s": [0.015, 0.03, 0.06], "encoder_resolution_rad": [0.002, 0.0005, 0.001]}
    head = head_of("tied").replace(actuators=lags)
    task = GazeTask(8, plant="kinematic", head=head)
    trial = run(task, "saccade", 120)
    lag_s = np.array([p.lag_s for p in trial.predicted])
    assert np.abs(lag_s[-1] - 0.03).max() < 0.003
    for place in range(8):
        assert settle_time(trial.errors[:, place : place + 1], 1 / 120) < 0.4
