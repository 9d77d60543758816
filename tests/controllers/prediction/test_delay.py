"""Estimation of the image delay: updated while the eyes turn, unchanged while they rest."""

import numpy as np
import pytest

from tests.controllers.prediction.observed import predict, predictor_of, record, turns
from tests.controllers.reaching import run
from vergence import load_head
from vergence.controllers.prediction.predictor import SmithPredictor
from vergence.envs.observation import ObservationLayout
from vergence.envs.task import GazeTask

HEAD = load_head("simulated")
NOMINAL_S = HEAD.timing.latency_s


@pytest.mark.parametrize("off_s", [-0.04, 0.0, 0.04])
def test_one_saccade_tells_a_delay_that_is_off_by_forty_milliseconds(off_s) -> None:
    task = GazeTask(12, plant="kinematic", plant_options={"latency_s": NOMINAL_S + off_s})
    trial = run(task, "saccade", 50)
    assert np.allclose(trial.predicted[0].image_delay_s, NOMINAL_S, atol=0.002)
    found = trial.predicted[-1].image_delay_s
    assert np.abs(found - NOMINAL_S - off_s).max() < 0.008
    assert np.abs(np.median(found) - NOMINAL_S - off_s) < 0.004


def test_the_delay_is_that_less_the_latency_of_the_joints_readings() -> None:
    options = {"latency_s": 0.09, "feedback_latency_s": 0.015}
    task = GazeTask(12, plant="kinematic", plant_options=options)
    found = run(task, "saccade", 60).predicted[-1].image_delay_s
    assert np.abs(np.median(found) - 0.075) < 0.004


def test_frames_that_jitter_have_the_delay_of_their_mean() -> None:
    options = {"latency_s": 0.09, "jitter_s": 0.016, "frame_rate_hz": 60.0}
    task = GazeTask(12, plant="kinematic", plant_options=options)
    found = run(task, "saccade", 60).predicted[-1].image_delay_s
    assert np.abs(np.median(found) - 0.098) < 0.006


def test_nothing_is_learned_at_rest() -> None:
    still = record(HEAD, np.zeros((120, 4)), image_delay_s=0.1, noise_px=0.3)
    found = [float(one.image_delay_s) for one in predict(predictor_of(HEAD), still)]
    # what is known in advance, whose mean is not quite what the head says
    assert np.abs(np.array(found) - NOMINAL_S).max() < 0.001
    assert np.ptp(found[30:]) < 1e-9


def test_a_nominal_delay_is_never_doubted() -> None:
    predictor = SmithPredictor(head=HEAD, layout=ObservationLayout.of(HEAD), delay="nominal")
    found = predict(predictor, record(HEAD, turns(HEAD, 60), image_delay_s=0.1))
    assert np.allclose([one.image_delay_s for one in found], NOMINAL_S, atol=1e-6)


@pytest.mark.parametrize("delay_s", [0.04, 0.1])
def test_images_of_an_unknown_delay_do_not_lead_a_saccade_astray(delay_s) -> None:
    head = HEAD.replace(sensor={"detection_noise_px": 0.0})
    task = GazeTask(12, head=head, plant="kinematic", plant_options={"latency_s": delay_s})
    trial = run(task, "saccade", 60)
    goals = np.array([one.positions + one.angle_error for one in trial.predicted])
    goals = goals[round(delay_s * 120) + 1 :]
    # the first image shows eyes at rest, which no delay makes wrong; 1 mrad is 0.6 px
    assert np.abs(goals - goals[0]).max() < 0.003
    assert np.abs(goals[-1] - goals[0]).max() < 0.001


@pytest.mark.parametrize("true_s", [0.03, 0.15])
def test_stamps_of_the_camera_date_images_however_late_they_come(true_s) -> None:
    head = HEAD.replace(timing={"exposure_stamps": True}, sensor={"detection_noise_px": 0.0})
    task = GazeTask(12, head=head, plant="kinematic", plant_options={"latency_s": true_s})
    trial = run(task, "saccade", 70)
    # what is left to date is the readings of the joints, which come at once here
    assert np.abs(trial.predicted[-1].image_delay_s).max() < 0.006
    assert np.linalg.norm(trial.errors[-5:], axis=-1).max() < 1.0


def test_stamps_tell_how_late_the_readings_of_the_joints_are() -> None:
    head = HEAD.replace(timing={"exposure_stamps": True})
    task = GazeTask(12, head=head, plant="kinematic", plant_options={"feedback_latency_s": 0.02})
    found = run(task, "saccade", 70).predicted[-1].image_delay_s
    assert np.abs(np.median(found) + 0.02) < 0.005
