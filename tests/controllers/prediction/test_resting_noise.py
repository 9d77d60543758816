"""How far noise moves the prediction of a resting target, against many simulated filters."""

import numpy as np
import pytest

from vergence import load_head
from vergence.controllers.prediction.resting_noise import (
    LEAST_ACCELERATION_SD,
    WANDER_PX,
    calm_acceleration_sd,
    resting_wander,
)
from vergence.controllers.prediction.singer import singer_noise, singer_transition
from vergence.controllers.prediction.target_motion import measured_variance
from vergence.errors import ConfigurationError

TURRETS = load_head("turrets")


def simulated_wander(head, sd: float, time_s: float, runs: int = 4000) -> float:
    """The same from Kalman filters that are fed noise, in px."""
    rng = np.random.default_rng(0)
    frame_s, variance = 1.0 / head.timing.frame_rate_hz, measured_variance(head, None)
    transition, noise = singer_transition(frame_s, time_s), singer_noise(frame_s, time_s, sd)
    states, covariance = np.zeros((runs, 3)), np.diag([variance, 0.25, sd**2])
    for _ in range(150):
        states, covariance = states @ transition.T, transition @ covariance @ transition.T + noise
        gain = covariance[:, 0] / (covariance[0, 0] + variance)
        seen = rng.normal(0.0, np.sqrt(variance), runs)
        states = states + np.outer(seen - states[:, 0], gain)
        covariance = covariance - np.outer(gain, covariance[0])
    ahead = singer_transition(head.timing.latency_s + frame_s, time_s)[0]
    return float((states @ ahead).std()) * head.cameras.focal.min()


@pytest.mark.parametrize(("name", "sd"), [("turrets", 1.0), ("icub", 0.3), ("simulated", 2.0)])
def test_it_is_what_filters_that_see_noise_alone_scatter_by(name, sd):
    head = load_head(name)
    wander = resting_wander(head, acceleration_sd=sd, acceleration_time_s=0.5)
    # 4,000 runs know a standard deviation to 1.1 %
    assert wander == pytest.approx(simulated_wander(head, sd, 0.5), rel=0.05)


def test_where_noise_would_move_the_eyes_the_target_is_taken_to_be_calmer():
    sd = calm_acceleration_sd(TURRETS, acceleration_time_s=1.0, most=1.0)
    wander = resting_wander(TURRETS, acceleration_sd=sd, acceleration_time_s=1.0)
    assert 0.99 * WANDER_PX < wander <= WANDER_PX


def test_where_noise_is_small_it_is_not():
    for name in ("simulated", "physical"):
        assert calm_acceleration_sd(load_head(name), acceleration_time_s=1.0, most=1.0) == 1.0


@pytest.mark.parametrize("noise_px", [0.0, 1e-3, 5.0])
@pytest.mark.parametrize("time_s", [0.01, 10.0])
def test_any_noise_and_any_time_constant_have_an_answer(noise_px, time_s):
    head = TURRETS.replace(sensor={"detection_noise_px": noise_px})
    sd = calm_acceleration_sd(head, acceleration_time_s=time_s, most=1.0)
    assert 0.999 * LEAST_ACCELERATION_SD <= sd <= 1.0


def test_a_time_constant_that_cannot_be_is_refused():
    with pytest.raises(ConfigurationError, match="acceleration_time_s: expected a finite number"):
        calm_acceleration_sd(TURRETS, acceleration_time_s=np.inf, most=1.0)
