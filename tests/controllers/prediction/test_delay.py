"""Estimation of the image delay: updated while the eyes turn, unchanged while they rest."""

import numpy as np
import pytest

from tests.controllers.prediction.observed import predict, predictor_of, record, saccades
from vergence import load_head

HEAD = load_head("simulated")
NOMINAL_S = HEAD.timing.latency_s
QUIET = HEAD.replace(sensor={"detection_noise_px": 0.0})
STAMPS = QUIET.replace(timing={"exposure_stamps": True})


@pytest.mark.parametrize("off_s", [-0.04, 0.0, 0.04])
def test_one_saccade_tells_a_delay_that_is_off_by_forty_milliseconds(off_s) -> None:
    trial = saccades(HEAD, 50, latency_s=NOMINAL_S + off_s)
    assert np.allclose(trial.predicted[0].image_delay_s, NOMINAL_S, atol=0.002)
    found = trial.predicted[-1].image_delay_s
    assert np.abs(found - NOMINAL_S - off_s).max() < 0.008
    assert np.abs(np.median(found) - NOMINAL_S - off_s) < 0.004


@pytest.mark.parametrize(
    ("head", "options", "expected_s"),
    [
        (HEAD, {"latency_s": 0.09, "feedback_latency_s": 0.015}, 0.075),
        (HEAD, {"latency_s": 0.09, "jitter_s": 0.016, "frame_rate_hz": 60.0}, 0.098),
        (STAMPS, {"feedback_latency_s": 0.02}, -0.02),
    ],
    ids=["late readings", "frames that jitter", "stamps of the camera"],
)
def test_the_delay_is_that_of_the_mean_frame_less_that_of_readings(head, options, expected_s):
    found = saccades(head, 70, **options).predicted[-1].image_delay_s
    assert np.abs(np.median(found) - expected_s) < 0.004


def test_nothing_is_learned_at_rest() -> None:
    still = record(HEAD, np.zeros((120, 4)), image_delay_s=0.1, noise_px=0.3)
    every = predict(predictor_of(HEAD), still)
    found = [float(one.image_delay_s) for one in every]
    # what is known in advance, whose mean is not quite what the head says
    assert np.abs(np.array(found) - NOMINAL_S).max() < 0.001
    assert np.ptp(found[30:]) < 1e-9
    for name in (
        "response_latency_s", "lag_s", "acceleration_ratio", "response_latency_sd_s",
        "acceleration_sd",
    ):  # fmt: skip
        assert len({float(getattr(one, name)) for one in every}) == 1


@pytest.mark.parametrize("delay_s", [0.04, 0.1])
def test_images_of_an_unknown_delay_do_not_lead_a_saccade_astray(delay_s) -> None:
    trial = saccades(QUIET, 60, latency_s=delay_s)
    goals = np.array([one.positions + one.angle_error for one in trial.predicted])
    goals = goals[round(delay_s * 120) + 1 :]
    # the first image shows eyes at rest, which no delay makes wrong; 1 mrad is 0.6 px
    assert np.abs(goals - goals[0]).max() < 0.003
    assert np.abs(goals[-1] - goals[0]).max() < 0.001


@pytest.mark.parametrize("true_s", [0.03, 0.15])
def test_stamps_of_the_camera_date_images_however_late_they_come(true_s) -> None:
    trial = saccades(STAMPS, 70, latency_s=true_s)
    # what is left to date is the readings of the joints, which come at once here
    assert np.abs(trial.predicted[-1].image_delay_s).max() < 0.006
    assert np.linalg.norm(trial.errors[-5:], axis=-1).max() < 1.0
