"""The predictor on heads of any shape: axes at any angle, joints tied or missing."""

import numpy as np
import pytest

from tests.controllers.loops import settle_time
from tests.controllers.reaching import run
from tests.heads import CENTRE, IMAGE, LOOP, eyes, head_of, joint
from tests.naming import named
from vergence import load_head
from vergence.controllers.prediction.parameters import (
    PREDICTOR_PARAMETERS,
    pack_predictor_parameters,
    with_virtual_joints,
)
from vergence.envs.task import GazeTask
from vergence.models import parse_head
from vergence.models.fixation import fixate_eye
from vergence.models.kinematics import eye_frames

EXACT = {"detection_noise_px": 0.0, "encoder_resolution_rad": 0.0, "velocity_resolution_rad_s": 0.0}


def skewed():
    """A head whose axes are in no way at right angles; its eyes turn about their centres."""
    text = 'name = "skewed"\n'
    for eye, side in (("left", -1), ("right", 1)):
        text += joint(f"{eye}_one", eye, (side * 0.05, 0, 0), (0.9, 0.3 * side, 0.1))
        text += joint(f"{eye}_two", eye, CENTRE, (0.35, 0.9, -0.2 * side))
    return parse_head(text + IMAGE + eyes() + LOOP)


def test_axes_at_right_angles_are_told_from_others() -> None:
    for head, told in ((head_of("panfirst"), 1.0), (load_head("simulated"), 1.0), (skewed(), 0.0)):
        params = pack_predictor_parameters(head).view(PREDICTOR_PARAMETERS)
        assert (params["orthogonal_axes"] == told).all()


@pytest.mark.parametrize(
    ("head", "delay"),
    [(skewed(), 4), (head_of("panfirst"), 13), (head_of("tied"), 13), (head_of("mis"), 4)],
)
def test_one_saccade_tells_the_delay_on_any_head(head, delay) -> None:
    task = GazeTask(8, plant="kinematic", head=head, plant_options={"latency_s": delay / 120.0})
    trial = run(task, "saccade", 60)
    found = trial.predicted[-1].image_delay_s
    assert np.abs(np.median(found) - delay / 120.0) < 0.005


@pytest.mark.parametrize("name", ["mis", "panfirst", "vergeonly"])
def test_without_noise_the_prediction_is_the_error_at_its_angles_on_any_head(name) -> None:
    head = head_of(name).replace(sensor=EXACT)
    task = GazeTask(8, head=head, plant="kinematic")
    trial = run(task, "saccade", 60)
    target = task.truth().target
    for now in trial.predicted[12::4]:
        q = np.concatenate([np.tile(head.rest()[:3], (8, 1)), now.positions], axis=-1)
        error = head.project(q, target, distorted=False) - head.cameras.principal
        assert np.linalg.norm(now.pixel_error - error, axis=-1).max() < 0.7


def test_joints_made_up_for_an_eye_leave_the_cameras_where_they_are() -> None:
    for name in ["common", "vergeonly", "pair"]:
        with named(name):
            head = head_of(name)
            q = np.zeros(7)
            q[3:] = np.where([bool(one) for one in head.joints[3:]], [0.2, -0.1, 0.2, -0.1], 0.0)
            packed = with_virtual_joints(head)
            for eye in range(2):
                angles = q[3 + 2 * eye : 5 + 2 * eye]
                own = eye_frames(head.packed, eye, *angles).camera
                assert eye_frames(packed, eye, *angles).camera == pytest.approx(own)
                assert np.isfinite(fixate_eye(packed, eye, 0.1, 0.15, 0.9)).all()


def test_each_actuator_is_followed_by_its_own_lag_and_encoder() -> None:
    lags = {"lag_s": [0.015, 0.03, 0.06], "encoder_resolution_rad": [0.002, 0.0005, 0.001]}
    head = head_of("tied").replace(actuators=lags)
    task = GazeTask(8, plant="kinematic", head=head)
    trial = run(task, "saccade", 120)
    lag_s = np.array([p.lag_s for p in trial.predicted])
    assert np.abs(np.median(lag_s[-1]) - 0.03) < 0.003
    for place in range(8):
        assert settle_time(trial.errors[:, place : place + 1], 1 / 120) < 0.4
